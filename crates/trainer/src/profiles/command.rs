//! `osteotome profiles`, and sessions taken into a profile.
use super::export::{Form, exported};
use super::store::Store;
use crate::cli::{Failure, ProfilesArgs, ProfilesTask};
use crate::debrief::Figures;
use crate::report_command::write_whole;
use crate::talk;
use anyhow::{Context, Result};
use std::path::Path;

/// Opens the user's profiles.
///
/// # Errors
/// As [`Store::open`]; a system that has no folder for such things.
pub fn store() -> Result<Store> {
    let folder = super::folder().with_context(|| {
        format!(
            "this system names no folder for profiles; name one in {}",
            super::FOLDER_VARIABLE
        )
    })?;
    Store::open(&folder)
}

/// `profiles`.
pub fn profiles(args: &ProfilesArgs) -> Result<(), Failure> {
    let mut store = store().map_err(Failure::Input)?;
    done(&mut store, &args.task).map_err(Failure::Input)
}

fn done(store: &mut Store, task: &ProfilesTask) -> Result<()> {
    match task {
        ProfilesTask::List => list(store),
        ProfilesTask::Add { name } => {
            let name = store.add(name)?;
            talk::say(&format!("{name}: added."));
            Ok(())
        }
        ProfilesTask::Show { name } => show(store, name),
        ProfilesTask::Export { name, output } => {
            let n = export(store, name, output)?;
            talk::say(&format!("{n} session(s): {}", output.display()));
            Ok(())
        }
        ProfilesTask::Delete { name, session } => {
            match session {
                Some(id) => store.delete_session(name, *id)?,
                None => store.delete(name)?,
            }
            talk::say("Deleted. Session folders are left where they are.");
            Ok(())
        }
    }
}

/// Writes a profile's sessions, as CSV if the file is called so, else as JSON; says how many.
///
/// # Errors
/// As [`Store::sessions`], and what the file system says.
pub fn export(store: &mut Store, name: &str, output: &Path) -> Result<usize> {
    let sessions = store.sessions(name)?;
    let is_csv = output.extension().is_some_and(|e| e == "csv");
    let form = if is_csv { Form::Csv } else { Form::Json };
    write_whole(output, &exported(name, &sessions, form)?)?;
    Ok(sessions.len())
}

fn list(store: &mut Store) -> Result<()> {
    let profiles = store.list()?;
    if profiles.is_empty() {
        talk::say("There is no profile yet; `osteotome profiles add NAME` makes one.");
    }
    for p in profiles {
        let last = p
            .last
            .map_or_else(String::new, |day| format!(", the last on {day}"));
        talk::say(&format!("{}: {} session(s){last}", p.name, p.n_sessions));
    }
    Ok(())
}

fn show(store: &mut Store, name: &str) -> Result<()> {
    let sessions = store.sessions(name)?;
    talk::say("Number  Ended (UTC)       Score  Split after  Scenario, folder");
    for s in &sessions {
        let score = s.figures.score();
        let score = score.map_or_else(|| "-".to_owned(), |v| format!("{v:.0} %"));
        let split = s.figures.value("Time until the split");
        let split = split.map_or_else(|| "-".to_owned(), |v| format!("{v:.1} s"));
        talk::say(&format!(
            "{:>6}  {}  {score:>5}  {split:>11}  {}, {}",
            s.id, s.ended, s.scenario, s.folder
        ));
    }
    Ok(())
}

/// Takes a session into a profile. Its folder is there already, whatever happens here.
///
/// # Errors
/// One line.
pub fn add_to(
    store: &mut Store,
    name: &str,
    scenario: &str,
    folder: &Path,
    figures: &Figures,
) -> Result<()> {
    let folder = folder.file_name().unwrap_or_default().to_string_lossy();
    store
        .remember(name, scenario, &folder, figures)
        .with_context(|| format!("the session is kept, but not in the history of {name}"))
}

/// What is known of a profile's sessions, each called by its date.
///
/// # Errors
/// As [`Store::sessions`].
pub fn figures(store: &mut Store, name: &str) -> Result<Vec<Figures>> {
    let named = |mut entry: super::Entry| {
        entry.figures.name = format!("{}, {}", entry.ended, entry.folder);
        entry.figures
    };
    Ok(store.sessions(name)?.into_iter().map(named).collect())
}
