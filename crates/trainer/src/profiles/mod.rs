//! Local profiles: who trains here, by a name of their own choice, and what their sessions came to.
//!
//! An SQLite file in the user's data folder, or in the one that `OSTEOTOME_DATA` names. Besides the name nothing about a person is in
//! it: of each session the time, the scenario's title, the folder's last name, and the debrief's figures. Recordings are not in it,
//! so that no fault of this file can lose a session.
mod command;
mod export;
mod store;

pub use command::{add_to, export, figures, profiles, store};
pub use store::{Entry, LONGEST_NAME, Store};

use std::path::PathBuf;

/// Names another folder for the profiles.
pub const FOLDER_VARIABLE: &str = "OSTEOTOME_DATA";

/// Where profiles are kept.
pub fn folder() -> Option<PathBuf> {
    let named = std::env::var_os(FOLDER_VARIABLE).filter(|v| !v.is_empty());
    named.map(PathBuf::from).or_else(|| {
        directories::ProjectDirs::from("", "", "osteotome").map(|d| d.data_dir().to_owned())
    })
}
