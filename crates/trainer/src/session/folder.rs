use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};

/// A folder of results in the making: `DIR.partial`, renamed to `DIR` at the end. Dropped before that, it goes away.
#[derive(Debug)]
pub struct SessionFolder {
    partial: PathBuf,
    wanted: PathBuf,
    mark: &'static Mark,
    is_done: bool,
}

/// By what a folder is known as an earlier result of the same kind, which may be replaced.
#[derive(Debug)]
pub struct Mark {
    /// A file in it.
    pub file: &'static str,
    /// What it is called.
    pub what: &'static str,
}

/// The mark of a session.
pub const SESSION: Mark = Mark {
    file: "session.mcap",
    what: "a session",
};

impl SessionFolder {
    /// Starts a folder that will become `wanted`.
    ///
    /// # Errors
    /// If `wanted` is there and neither empty nor marked, or cannot be made.
    pub fn create(wanted: &Path, mark: &'static Mark) -> Result<Self> {
        check_replaceable(wanted, mark)?;
        let mut name = wanted
            .file_name()
            .with_context(|| format!("--out {}: this names no folder", wanted.display()))?
            .to_owned();
        name.push(".partial");
        let partial = wanted.with_file_name(name);
        if partial.join(mark.file).exists() {
            set_aside(&partial, wanted)?;
        } else if partial.exists() {
            std::fs::remove_dir_all(&partial).with_context(|| partial.display().to_string())?;
        }
        std::fs::create_dir_all(&partial)
            .with_context(|| format!("--out {}: cannot be made", wanted.display()))?;
        Ok(Self {
            partial,
            wanted: wanted.to_owned(),
            mark,
            is_done: false,
        })
    }

    /// Whether [`create`](Self::create) may be expected to succeed; writes nothing.
    ///
    /// # Errors
    /// If `wanted` is there and neither empty nor marked.
    pub fn check(wanted: &Path, mark: &Mark) -> Result<()> {
        check_replaceable(wanted, mark)
    }

    /// Where to write until the folder is finished and renamed.
    pub fn path(&self) -> &Path {
        &self.partial
    }

    /// Writes a text file into it.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub fn write(&self, name: &str, text: &str) -> Result<()> {
        let path = self.partial.join(name);
        std::fs::write(&path, text).with_context(|| path.display().to_string())
    }

    /// Keeps what there is as `DIR.interrupted`, if that is worth anything.
    pub fn keep(mut self) -> Option<PathBuf> {
        let is_worth_it = self.partial.join(self.mark.file).is_file();
        let kept = is_worth_it.then(|| set_aside(&self.partial, &self.wanted).ok())?;
        self.is_done = kept.is_some();
        kept
    }

    /// Makes the folder appear under its name; an earlier one there goes away.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub fn finish(mut self) -> Result<PathBuf> {
        check_replaceable(&self.wanted, self.mark)?;
        if self.wanted.exists() {
            std::fs::remove_dir_all(&self.wanted)
                .with_context(|| self.wanted.display().to_string())?;
        }
        std::fs::rename(&self.partial, &self.wanted)
            .with_context(|| self.wanted.display().to_string())?;
        self.is_done = true;
        Ok(self.wanted.clone())
    }
}

impl Drop for SessionFolder {
    fn drop(&mut self) {
        if !self.is_done {
            // Nothing half written stays behind; if even this fails, the name says what it is.
            let _ = std::fs::remove_dir_all(&self.partial);
        }
    }
}

/// What a killed or failed session left is kept under the first free name of `DIR.interrupted`, `DIR.interrupted-2` and so on.
fn set_aside(partial: &Path, wanted: &Path) -> Result<PathBuf> {
    let name = |k: usize| {
        let mut name = wanted.file_name().unwrap_or_default().to_owned();
        name.push(".interrupted");
        if k > 1 {
            name.push(format!("-{k}"));
        }
        wanted.with_file_name(name)
    };
    let free = (1..1000).map(name).find(|p| !p.exists());
    let free = free.context("there are 999 interrupted sessions of this name; remove some")?;
    std::fs::rename(partial, &free).with_context(|| free.display().to_string())?;
    Ok(free)
}

fn check_replaceable(wanted: &Path, mark: &Mark) -> Result<()> {
    let shown = wanted.display();
    if !wanted.exists() {
        return Ok(());
    }
    if !wanted.is_dir() {
        bail!("--out {shown}: there is a file of this name; give a folder");
    }
    let is_empty = std::fs::read_dir(wanted)
        .with_context(|| shown.to_string())?
        .next()
        .is_none();
    if !is_empty && !wanted.join(mark.file).is_file() {
        bail!(
            "--out {shown}: the folder holds something else than {}; give a new or an empty folder",
            mark.what
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn appears_whole_or_not_at_all() {
        let base = tempfile::tempdir().unwrap();
        let wanted = base.path().join("deep/out");
        let folder = SessionFolder::create(&wanted, &SESSION).unwrap();
        folder.write("session.mcap", "1").unwrap();
        assert!(!wanted.exists());
        folder.finish().unwrap();
        assert!(wanted.join("session.mcap").is_file());
        drop(SessionFolder::create(&wanted, &SESSION).unwrap());
        assert_eq!(
            std::fs::read_dir(base.path().join("deep")).unwrap().count(),
            1
        );
    }

    #[test]
    fn what_a_killed_session_left_is_set_aside() {
        let base = tempfile::tempdir().unwrap();
        let wanted = base.path().join("out");
        for n in 1..=2 {
            let killed = base.path().join("out.partial");
            std::fs::create_dir(&killed).unwrap();
            std::fs::write(killed.join("session.mcap"), n.to_string()).unwrap();
            drop(SessionFolder::create(&wanted, &SESSION).unwrap());
        }
        let kept = |name: &str| std::fs::read_to_string(base.path().join(name)).unwrap();
        assert_eq!(kept("out.interrupted/session.mcap"), "1");
        assert_eq!(kept("out.interrupted-2/session.mcap"), "2");
        let folder = SessionFolder::create(&wanted, &SESSION).unwrap();
        assert_eq!(folder.keep(), None, "nothing was recorded");
        assert!(!base.path().join("out.partial").exists());
    }

    #[test]
    fn a_session_is_replaced_but_nothing_else() {
        let base = tempfile::tempdir().unwrap();
        std::fs::write(base.path().join("thesis.txt"), "").unwrap();
        let error = SessionFolder::create(base.path(), &SESSION)
            .unwrap_err()
            .to_string();
        assert!(error.contains("something else"), "{error}");
        let wanted = base.path().join("out");
        for text in ["1", "2"] {
            let folder = SessionFolder::create(&wanted, &SESSION).unwrap();
            folder.write("session.mcap", text).unwrap();
            folder.finish().unwrap();
        }
        assert_eq!(
            std::fs::read_to_string(wanted.join("session.mcap")).unwrap(),
            "2"
        );
    }
}
