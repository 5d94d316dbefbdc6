//! What the window remembers from one time to the next.
use crate::picture::{StereoMode, View};
use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Names another folder for the settings.
pub const FOLDER_VARIABLE: &str = "OSTEOTOME_CONFIG";
/// A file longer than this is none of ours \[bytes\].
const MOST_BYTES: u64 = 64 * 1024;
/// Scenarios remembered.
const MOST_RECENT: usize = 6;

/// All of it. A key that is missing has its default; a file that cannot be read counts as none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// The scenario last trained: a shipped one's name, or a file.
    pub scenario: String,
    /// Scenario files of late, the latest first.
    pub recent: Vec<PathBuf>,
    /// Who leads the left and the right hand: `surgeon`, `mouse`, or a device as a scenario names it.
    pub hands: [String; 2],
    /// Where sessions are kept.
    pub sessions: PathBuf,
    /// From where the scene is seen; absent, once turned by hand: the usual view next time.
    pub view: Option<View>,
    /// Whether one looks through the bone.
    pub is_transparent: bool,
    /// Whether arrows show the loads.
    pub shows_loads: bool,
    /// Whether a schematic head is shown.
    pub shows_head: bool,
    /// For two eyes.
    pub stereo: Option<StereoMode>,
    /// Whether pictures are drawn into session folders.
    pub draws_pictures: bool,
    /// Whether the coach says anything, and shows the planned plane.
    pub shows_hints: bool,
    /// See there.
    pub shows_plan: bool,
    /// Whether the window is for an exam: no hints.
    pub is_exam: bool,
    /// Whether the guided first run has been gone through, or left out.
    pub has_been_guided: bool,
    /// Whose history sessions go into; empty: nobody's.
    pub profile: String,
    /// Size of letters against the usual.
    pub zoom: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            scenario: super::catalogue::SHIPPED[0].0.to_owned(),
            recent: Vec::new(),
            hands: ["surgeon", "surgeon"].map(str::to_owned),
            sessions: home().join("osteotome-sessions"),
            view: Some(View::Close),
            is_transparent: false,
            shows_loads: true,
            shows_head: false,
            stereo: None,
            draws_pictures: true,
            shows_hints: true,
            shows_plan: true,
            is_exam: false,
            has_been_guided: false,
            profile: String::new(),
            zoom: 1.0,
        }
    }
}

fn home() -> PathBuf {
    directories::UserDirs::new().map_or_else(PathBuf::new, |d| d.home_dir().to_owned())
}

/// Where settings are kept: `OSTEOTOME_CONFIG`, or the user's folder for such things.
pub fn folder() -> Option<PathBuf> {
    let named = std::env::var_os(FOLDER_VARIABLE).filter(|v| !v.is_empty());
    named.map(PathBuf::from).or_else(|| {
        directories::ProjectDirs::from("", "", "osteotome").map(|d| d.config_dir().to_owned())
    })
}

impl Settings {
    /// Reads them; the second says what was wrong with the file, if anything.
    pub fn read(folder: &Path) -> (Self, Option<String>) {
        let path = folder.join("window.toml");
        let text = match std::fs::metadata(&path) {
            Ok(data) if data.len() <= MOST_BYTES => std::fs::read_to_string(&path),
            Ok(_) => Err(std::io::Error::other("too long")),
            Err(_) => return (Self::default(), None),
        };
        let read = text
            .map_err(|e| e.to_string())
            .and_then(|t| toml::from_str::<Self>(&t).map_err(|e| e.message().to_owned()));
        match read {
            Ok(settings) => (settings.bounded(), None),
            Err(error) => (
                Self::default(),
                Some(format!("{}: {error}; defaults are used", path.display())),
            ),
        }
    }

    fn bounded(mut self) -> Self {
        self.recent.truncate(MOST_RECENT);
        self.zoom = if self.zoom.is_finite() {
            self.zoom.clamp(0.6, 2.5)
        } else {
            1.0
        };
        self
    }

    /// Writes them; the file appears whole or not at all.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub fn write(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        let path = folder.join("window.toml");
        let partial = folder.join("window.toml.partial");
        std::fs::write(&partial, toml::to_string(self)?)
            .and_then(|()| std::fs::rename(&partial, &path))
            .with_context(|| path.display().to_string())
    }

    /// Puts a scenario file first among those of late.
    pub fn remember(&mut self, file: &Path) {
        self.recent.retain(|f| f != file);
        self.recent.insert(0, file.to_owned());
        self.recent.truncate(MOST_RECENT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_and_what_is_broken_is_named() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Settings::read(folder.path()), (Settings::default(), None));
        let mut settings = Settings {
            stereo: Some(StereoMode::Anaglyph),
            view: Some(View::Top),
            zoom: 1.25,
            ..Settings::default()
        };
        (0..9).for_each(|i| settings.remember(Path::new(&format!("/{i}.toml"))));
        settings.remember(Path::new("/5.toml"));
        assert_eq!(settings.recent.len(), MOST_RECENT);
        assert_eq!(settings.recent[0], Path::new("/5.toml"));
        settings.write(folder.path()).unwrap();
        assert_eq!(Settings::read(folder.path()), (settings, None));
        std::fs::write(folder.path().join("window.toml"), "zoom = \"big\"").unwrap();
        let (read, wrong) = Settings::read(folder.path());
        assert_eq!(read, Settings::default());
        assert!(wrong.unwrap().contains("window.toml"));
        std::fs::write(folder.path().join("window.toml"), "zoom = nan").unwrap();
        assert_eq!(Settings::read(folder.path()).0.zoom, 1.0);
    }
}
