//! The database.
use crate::debrief::Figures;
use anyhow::{Context, Result, anyhow, bail, ensure};
use rusqlite::{Connection, ErrorCode, OptionalExtension, params};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Of the tables, in SQLite's `user_version`.
const VERSION: i64 = 1;
/// Another program that writes is waited for no longer than this: the window asks from its own thread.
const PATIENCE: Duration = Duration::from_millis(500);
/// A name is no longer \[characters\].
pub const LONGEST_NAME: usize = 40;
/// Of a session's figures \[bytes\].
const MOST_BYTES: usize = 64 * 1024;
/// Sessions of a profile that are read, the latest.
const MOST_SESSIONS: i64 = 10_000;

const TABLES: &str = "
    CREATE TABLE profile (
        id INTEGER PRIMARY KEY,
        name TEXT NOT NULL UNIQUE COLLATE NOCASE
    ) STRICT;
    CREATE TABLE session (
        id INTEGER PRIMARY KEY,
        profile INTEGER NOT NULL REFERENCES profile (id) ON DELETE CASCADE,
        ended_s INTEGER NOT NULL,
        scenario TEXT NOT NULL,
        folder TEXT NOT NULL,
        figures TEXT NOT NULL
    ) STRICT;
    CREATE INDEX session_of_profile ON session (profile);
";

/// A profile in a list.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Chosen by its owner.
    pub name: String,
    /// Sessions kept.
    pub n_sessions: usize,
    /// The last one's date, UTC.
    pub last: Option<String>,
}

/// A session of a profile.
#[derive(Clone, Debug)]
pub struct Entry {
    /// By which it is deleted.
    pub id: i64,
    /// Date and time when it ended, UTC.
    pub ended: String,
    /// The scenario's title.
    pub scenario: String,
    /// The session folder's own name.
    pub folder: String,
    /// As in the debrief.
    pub figures: Figures,
}

/// The open database.
pub struct Store {
    connection: Connection,
    path: PathBuf,
}

impl Store {
    /// Opens the database in `folder`, which is made if it is not there.
    ///
    /// # Errors
    /// One line: a folder that cannot be written, a file that is damaged, of a later version, or in use.
    pub fn open(folder: &Path) -> Result<Self> {
        let path = folder.join("profiles.sqlite");
        std::fs::create_dir_all(folder).with_context(|| {
            format!(
                "profiles cannot be kept in {}; name another folder in {}",
                folder.display(),
                super::FOLDER_VARIABLE
            )
        })?;
        let open = || -> rusqlite::Result<(Connection, i64)> {
            let connection = Connection::open(&path)?;
            connection.busy_timeout(PATIENCE)?;
            // What is deleted is overwritten.
            connection.execute_batch("PRAGMA foreign_keys = ON; PRAGMA secure_delete = ON;")?;
            let sound: String = connection.query_row("PRAGMA quick_check", [], |r| r.get(0))?;
            if sound != "ok" {
                return Err(rusqlite::Error::SqliteFailure(
                    rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_CORRUPT),
                    Some(sound.split_whitespace().collect::<Vec<_>>().join(" ")),
                ));
            }
            let version = connection.query_row("PRAGMA user_version", [], |r| r.get(0))?;
            Ok((connection, version))
        };
        let (connection, version) = open().map_err(|e| in_words(&e, &path))?;
        let mut this = Self { connection, path };
        match version {
            0 => this.make()?,
            VERSION => {}
            _ => bail!(
                "{}: made by a later version of osteotome; use that one, or move the file away",
                this.path.display()
            ),
        }
        Ok(this)
    }

    fn make(&mut self) -> Result<()> {
        self.work(|c| {
            let transaction = c.transaction()?;
            transaction.execute_batch(TABLES)?;
            transaction.pragma_update(None, "user_version", VERSION)?;
            transaction.commit()
        })
    }

    fn work<T>(&mut self, f: impl FnOnce(&mut Connection) -> rusqlite::Result<T>) -> Result<T> {
        f(&mut self.connection).map_err(|e| in_words(&e, &self.path))
    }

    /// All profiles by name.
    ///
    /// # Errors
    /// What the database says, in one line; likewise below.
    pub fn list(&mut self) -> Result<Vec<Profile>> {
        self.work(|c| {
            let mut query = c.prepare(
                "SELECT name, count(session.id), strftime('%Y-%m-%d', max(ended_s), 'unixepoch')
                 FROM profile LEFT JOIN session ON session.profile = profile.id
                 GROUP BY profile.id ORDER BY name",
            )?;
            let profile = |r: &rusqlite::Row| {
                Ok(Profile {
                    name: r.get(0)?,
                    n_sessions: r.get::<_, i64>(1)? as usize,
                    last: r.get(2)?,
                })
            };
            query.query_map([], profile)?.collect()
        })
    }

    /// A new profile; gives back the name as it is kept.
    pub fn add(&mut self, name: &str) -> Result<String> {
        let name = name.split_whitespace().collect::<Vec<_>>().join(" ");
        let n = name.chars().count();
        ensure!(
            (1..=LONGEST_NAME).contains(&n) && !name.chars().any(char::is_control),
            "a profile's name has 1 to {LONGEST_NAME} characters"
        );
        let n =
            self.work(|c| c.execute("INSERT OR IGNORE INTO profile (name) VALUES (?1)", [&name]))?;
        ensure!(n == 1, "there is a profile {name} already");
        Ok(name)
    }

    fn id(&mut self, name: &str) -> Result<i64> {
        let find = |c: &mut Connection| {
            let id = c.query_row("SELECT id FROM profile WHERE name = ?1", [name], |r| {
                r.get(0)
            });
            id.optional()
        };
        let id = self.work(find)?;
        id.with_context(|| {
            format!("there is no profile {name}; `osteotome profiles list` names those there are, `osteotome profiles add` makes one")
        })
    }

    /// Takes a session in that has just ended.
    pub fn remember(
        &mut self,
        name: &str,
        scenario: &str,
        folder: &str,
        figures: &Figures,
    ) -> Result<()> {
        let id = self.id(name)?;
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let now = now.map_or(0, |d| d.as_secs()) as i64;
        let figures = serde_json::to_string(figures)?;
        self.work(|c| {
            c.execute(
                "INSERT INTO session (profile, ended_s, scenario, folder, figures) VALUES (?1, ?2, ?3, ?4, ?5)",
                params![id, now, scenario, folder, figures],
            )
        })?;
        Ok(())
    }

    /// A profile's sessions, the first one first.
    pub fn sessions(&mut self, name: &str) -> Result<Vec<Entry>> {
        let id = self.id(name)?;
        type Row = (i64, String, String, String, String);
        let rows: Vec<Row> = self.work(|c| {
            let mut query = c.prepare(
                "SELECT id, strftime('%Y-%m-%d %H:%M', ended_s, 'unixepoch'), scenario, folder, figures
                 FROM session WHERE profile = ?1 ORDER BY id DESC LIMIT ?2",
            )?;
            let row = |r: &rusqlite::Row| {
                Ok((r.get(0)?, r.get(1)?, r.get(2)?, r.get(3)?, r.get(4)?))
            };
            query.query_map(params![id, MOST_SESSIONS], row)?.collect()
        })?;
        let entry = |(id, ended, scenario, folder, figures): Row| {
            let damaged = || damaged(&self.path, &format!("session {id} has no figures"));
            ensure!(figures.len() <= MOST_BYTES, damaged());
            Ok(Entry {
                figures: serde_json::from_str(&figures).map_err(|_| damaged())?,
                id,
                ended,
                scenario,
                folder,
            })
        };
        rows.into_iter().rev().map(entry).collect()
    }

    /// Removes a profile with all that is known of its sessions.
    pub fn delete(&mut self, name: &str) -> Result<()> {
        let id = self.id(name)?;
        self.work(|c| {
            c.execute("DELETE FROM profile WHERE id = ?1", [id])?;
            // Nothing of it stays in pages that have become free.
            c.execute_batch("VACUUM")
        })
    }

    /// Removes one session of a profile.
    pub fn delete_session(&mut self, name: &str, session: i64) -> Result<()> {
        let id = self.id(name)?;
        let n = self.work(|c| {
            let n = c.execute(
                "DELETE FROM session WHERE id = ?1 AND profile = ?2",
                [session, id],
            )?;
            c.execute_batch("VACUUM")?;
            Ok(n)
        })?;
        ensure!(
            n == 1,
            "{name} has no session {session}; `osteotome profiles show` gives their numbers"
        );
        Ok(())
    }
}

fn damaged(path: &Path, what: &str) -> anyhow::Error {
    anyhow!(
        "{}: the file is damaged ({what}); move it away to begin anew, recordings are not in it",
        path.display()
    )
}

fn in_words(error: &rusqlite::Error, path: &Path) -> anyhow::Error {
    let shown = path.display();
    match error.sqlite_error_code() {
        Some(ErrorCode::NotADatabase | ErrorCode::DatabaseCorrupt) => {
            damaged(path, &error.to_string())
        }
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
            anyhow!("{shown}: another program is writing to it; try again")
        }
        Some(ErrorCode::ReadOnly | ErrorCode::CannotOpen | ErrorCode::PermissionDenied) => anyhow!(
            "{shown}: cannot be written; give yourself the right to, or name another folder in {}",
            super::FOLDER_VARIABLE
        ),
        Some(ErrorCode::DiskFull) => anyhow!("{shown}: the disk is full"),
        _ => anyhow!("{shown}: {error}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures(score: f64) -> Figures {
        let json = serde_json::json!({"name": "Ada's \"secret\" session", "rows": [
            {"what": "Score", "unit": "%", "decimals": 0, "value": score, "why_not": ""}]});
        serde_json::from_value(json).unwrap()
    }

    #[test]
    fn sessions_are_remembered_listed_and_forgotten_for_good() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = Store::open(&folder.path().join("deep/data")).unwrap();
        assert_eq!(store.add("  Ada   L. ").unwrap(), "Ada L.");
        store.add("Bob").unwrap();
        let twice = store.add("ada l.").unwrap_err().to_string();
        assert!(twice.contains("already"), "{twice}");
        for score in [50.0, 70.0] {
            store
                .remember("Ada L.", "BSSO", "0001-bsso", &figures(score))
                .unwrap();
        }
        store
            .remember("Bob", "BSSO", "0002-bsso", &figures(10.0))
            .unwrap();
        drop(store);
        let mut store = Store::open(&folder.path().join("deep/data")).unwrap();
        let list = store.list().unwrap();
        assert_eq!((list[0].name.as_str(), list[0].n_sessions), ("Ada L.", 2));
        let sessions = store.sessions("Ada L.").unwrap();
        let scores: Vec<_> = sessions.iter().map(|s| s.figures.score()).collect();
        assert_eq!(scores, [Some(50.0), Some(70.0)]);
        assert_eq!(sessions[0].ended.len(), 16);
        store.delete_session("Ada L.", sessions[0].id).unwrap();
        assert!(
            store.delete_session("Bob", sessions[1].id).is_err(),
            "not Bob's"
        );
        assert_eq!(store.sessions("Ada L.").unwrap().len(), 1);
        store.delete("Ada L.").unwrap();
        assert!(
            store
                .sessions("Ada L.")
                .unwrap_err()
                .to_string()
                .contains("no profile Ada L.")
        );
        assert_eq!(store.sessions("Bob").unwrap().len(), 1);
        let bytes = std::fs::read(folder.path().join("deep/data/profiles.sqlite")).unwrap();
        let holds = |word: &[u8]| bytes.windows(word.len()).any(|w| w == word);
        assert!(
            !holds(b"Ada L.") && !holds(b"0001-bsso"),
            "still in the file"
        );
        assert!(holds(b"0002-bsso"));
    }

    #[test]
    fn what_is_wrong_with_the_file_is_one_line_each() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let told = |path: &Path| format!("{:#}", Store::open(path).err().unwrap());
        // Not a database, and one whose pages are overwritten.
        std::fs::create_dir(at("a")).unwrap();
        std::fs::write(
            at("a/profiles.sqlite"),
            "hello, this is no database at all ".repeat(99),
        )
        .unwrap();
        assert!(told(&at("a")).contains("damaged"), "{}", told(&at("a")));
        let mut store = Store::open(&at("b")).unwrap();
        store.add("Ada").unwrap();
        for _ in 0..60 {
            store
                .remember("Ada", "BSSO", &"x".repeat(400), &figures(1.0))
                .unwrap();
        }
        drop(store);
        let file = at("b/profiles.sqlite");
        let mut bytes = std::fs::read(&file).unwrap();
        let n = bytes.len();
        bytes[4096..n - 4096].fill(0xA5);
        std::fs::write(&file, bytes).unwrap();
        assert!(told(&at("b")).contains("damaged"), "{}", told(&at("b")));
        // In use.
        let mut store = Store::open(&at("c")).unwrap();
        let other = Connection::open(at("c/profiles.sqlite")).unwrap();
        other.execute_batch("BEGIN EXCLUSIVE").unwrap();
        let busy = store.add("Ada").unwrap_err().to_string();
        assert!(busy.contains("another program"), "{busy}");
        // A folder where the file should be, and a file where the folder should be.
        std::fs::create_dir_all(at("d/profiles.sqlite")).unwrap();
        assert!(
            told(&at("d")).contains("cannot be written"),
            "{}",
            told(&at("d"))
        );
        std::fs::write(at("e"), "").unwrap();
        assert!(told(&at("e")).contains("name another folder in OSTEOTOME_DATA"));
        // Of a later version.
        drop(Store::open(&at("f")).unwrap());
        let later = Connection::open(at("f/profiles.sqlite")).unwrap();
        later.pragma_update(None, "user_version", 2).unwrap();
        assert!(told(&at("f")).contains("later version"));
        for path in ["a", "b", "d", "e", "f"] {
            assert_eq!(told(&at(path)).lines().count(), 1, "{path}");
        }
    }

    #[test]
    fn names_are_short_and_printable() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = Store::open(folder.path()).unwrap();
        for name in ["", "   ", "a\u{7}b", &"x".repeat(41)] {
            assert!(store.add(name).is_err(), "{name:?}");
        }
        store.add(&"ä".repeat(40)).unwrap();
    }
}
