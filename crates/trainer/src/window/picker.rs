//! A list of files to open one from: scenarios and recorded sessions, folder by folder.
use super::app::Window;
use super::{panels, style};
use anyhow::{Context as _, Result};
use eframe::egui::{Button, Context, RichText, ScrollArea, vec2};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// A folder with more is listed up to here.
const MOST: usize = 2000;

/// A folder being looked through.
pub struct Picker {
    folder: PathBuf,
    /// Names, folders first, each in alphabetical order; hidden ones are left out.
    folders: Vec<String>,
    files: Vec<String>,
}

impl Picker {
    /// Lists a folder.
    ///
    /// # Errors
    /// One that cannot be read.
    pub fn list(folder: &Path) -> Result<Self> {
        let named = || folder.display().to_string();
        let folder = std::path::absolute(folder).with_context(named)?;
        let (mut folders, mut files) = (Vec::new(), Vec::new());
        for entry in std::fs::read_dir(&folder).with_context(named)?.take(MOST) {
            let Ok(entry) = entry else { continue };
            let name = entry.file_name().to_string_lossy().into_owned();
            // A link is what it leads to; one that leads nowhere is nothing.
            let is_folder = entry.path().is_dir();
            let extension = entry.path().extension().map(OsStr::to_ascii_lowercase);
            let opens = extension.is_some_and(|e| e == "toml" || e == "mcap");
            if is_folder && !name.starts_with('.') {
                folders.push(name);
            } else if opens && !is_folder && !name.starts_with('.') {
                files.push(name);
            }
        }
        folders.sort_by_key(|name| name.to_lowercase());
        files.sort_by_key(|name| name.to_lowercase());
        Ok(Self {
            folder,
            folders,
            files,
        })
    }
}

/// What has been clicked.
enum Chosen {
    Folder(PathBuf),
    File(PathBuf),
    Nothing,
}

/// Opens the list, in the folder of the file that was opened last, or in the working folder.
pub fn open(w: &mut Window) {
    let last = w.settings.recent.first().and_then(|f| f.parent());
    let places = last.into_iter().chain([Path::new(".")]);
    match places.map(Picker::list).reduce(Result::or) {
        Some(Ok(picker)) => w.picker = Some(picker),
        Some(Err(error)) => w.notify(format!("{error:#}")),
        None => {}
    }
}

/// Shows the list, if it is open.
pub fn show(w: &mut Window, ctx: &Context) {
    let Some(picker) = &w.picker else { return };
    let modal = panels::sheet("files").show(ctx, |ui| {
        ui.set_width(560.0);
        ui.heading("Open a scenario or a session");
        let folder = picker.folder.display().to_string();
        ui.label(RichText::new(folder).small().color(style::WEAK));
        let mut chosen = None;
        ui.horizontal(|ui| {
            let above = picker.folder.parent();
            let up = ui.add_enabled(above.is_some(), Button::new("Folder above"));
            if up.clicked() {
                chosen = above.map(|f| Chosen::Folder(f.to_owned()));
            }
            if ui.button("Kept sessions").clicked() {
                chosen = Some(Chosen::Folder(w.settings.sessions.clone()));
            }
        });
        ui.add_space(4.0);
        ScrollArea::vertical().max_height(360.0).show(ui, |ui| {
            let wide = vec2(ui.available_width(), 24.0);
            let mut row = |text: String| {
                let button = Button::new(text).frame(false).min_size(wide);
                ui.add(button).clicked()
            };
            for name in &picker.folders {
                if row(format!("{name}/")) {
                    chosen = Some(Chosen::Folder(picker.folder.join(name)));
                }
            }
            for name in &picker.files {
                if row(name.clone()) {
                    chosen = Some(Chosen::File(picker.folder.join(name)));
                }
            }
            if picker.folders.is_empty() && picker.files.is_empty() {
                let text = "No folder, scenario (.toml) or session (.mcap) here";
                ui.label(RichText::new(text).color(style::WEAK));
            }
        });
        ui.add_space(4.0);
        if ui.button("Close").clicked() {
            chosen = Some(Chosen::Nothing);
        }
        chosen
    });
    let closes = modal.should_close();
    match modal.inner {
        Some(Chosen::Folder(folder)) => match Picker::list(&folder) {
            Ok(picker) => w.picker = Some(picker),
            Err(error) => w.notify(format!("{error:#}")),
        },
        Some(Chosen::File(file)) => {
            w.picker = None;
            w.path = file.to_string_lossy().into_owned();
            panels::open_path(w);
        }
        Some(Chosen::Nothing) => w.picker = None,
        None if closes => w.picker = None,
        None => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_come_first_and_only_what_opens_is_listed() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["b.toml", "A.MCAP", "notes.txt", ".hidden.toml"] {
            std::fs::write(at(name), "").unwrap();
        }
        for name in ["zeta", "Alpha", ".git", "odd.toml"] {
            std::fs::create_dir(at(name)).unwrap();
        }
        let picker = Picker::list(folder.path()).unwrap();
        assert_eq!(picker.folders, ["Alpha", "odd.toml", "zeta"]);
        assert_eq!(picker.files, ["A.MCAP", "b.toml"]);
        let error = Picker::list(&at("none")).err().unwrap();
        assert!(format!("{error:#}").contains("none"), "{error:#}");
    }
}
