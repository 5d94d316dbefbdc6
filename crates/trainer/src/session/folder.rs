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
        if partial.exists() {
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
