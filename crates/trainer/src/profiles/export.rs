//! A profile's history for other programs.
use super::store::Entry;
use crate::debrief::Figures;
use serde::Serialize;

/// In which form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// One object.
    Json,
    /// A line a session.
    Csv,
}

#[derive(Serialize)]
struct Document<'a> {
    schema: &'static str,
    name: &'a str,
    sessions: Vec<Session<'a>>,
}

#[derive(Serialize)]
struct Session<'a> {
    id: i64,
    ended_utc: &'a str,
    scenario: &'a str,
    folder: &'a str,
    figures: &'a Figures,
}

/// All sessions of a profile.
pub fn exported(name: &str, sessions: &[Entry], form: Form) -> serde_json::Result<String> {
    match form {
        Form::Json => json(name, sessions),
        Form::Csv => Ok(csv(sessions)),
    }
}

impl<'a> Session<'a> {
    fn of(entry: &'a Entry) -> Self {
        Self {
            id: entry.id,
            ended_utc: &entry.ended,
            scenario: &entry.scenario,
            folder: &entry.folder,
            figures: &entry.figures,
        }
    }
}

fn json(name: &str, sessions: &[Entry]) -> serde_json::Result<String> {
    let text = serde_json::to_string_pretty(&Document {
        schema: "osteotome.profile/1",
        name,
        sessions: sessions.iter().map(Session::of).collect(),
    })?;
    Ok(text + "\n")
}

/// Columns of figures in the order in which they first come up; empty where a session has no such figure.
fn csv(sessions: &[Entry]) -> String {
    let mut columns: Vec<(&str, &str)> = vec![];
    for (what, unit, _) in sessions.iter().flat_map(|s| s.figures.rows()) {
        if !columns.iter().any(|c| c.0 == what) {
            columns.push((what, unit));
        }
    }
    let mut header: Vec<String> = ["id", "ended (UTC)", "scenario", "folder"]
        .map(str::to_owned)
        .into();
    header.extend(columns.iter().map(|(what, unit)| match *unit {
        "" => (*what).to_owned(),
        unit => format!("{what} [{unit}]"),
    }));
    let mut rows = vec![header];
    for s in sessions {
        let mut row = vec![
            s.id.to_string(),
            s.ended.clone(),
            s.scenario.clone(),
            s.folder.clone(),
        ];
        let value = |what: &str| s.figures.rows().find(|r| r.0 == what).and_then(|r| r.2);
        row.extend(
            columns
                .iter()
                .map(|c| value(c.0).map_or_else(String::new, |v| v.to_string())),
        );
        rows.push(row);
    }
    let line = |row: &Vec<String>| row.iter().map(|f| field(f)).collect::<Vec<_>>().join(",");
    rows.iter().map(|r| line(r) + "\r\n").collect()
}

/// As RFC 4180 has it; a text that a spreadsheet would take for a formula is led by an apostrophe.
fn field(text: &str) -> String {
    let is_number = text.parse::<f64>().is_ok();
    let is_formula = !is_number && text.starts_with(['=', '+', '-', '@']);
    let text = if is_formula {
        format!("'{text}")
    } else {
        text.to_owned()
    };
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(id: i64, scenario: &str, what: &str, value: Option<f64>) -> Entry {
        let figures = serde_json::json!({"name": "x", "rows": [
            {"what": what, "unit": "mm", "decimals": 1, "value": value, "why_not": ""}]});
        Entry {
            id,
            ended: "2026-11-28 17:00".into(),
            scenario: scenario.into(),
            folder: "0001".into(),
            figures: serde_json::from_value(figures).unwrap(),
        }
    }

    #[test]
    fn a_table_has_a_line_a_session_and_quotes_what_it_must() {
        let sessions = [
            entry(1, "=1+1", "A", Some(-2.5)),
            entry(2, "a, \"b\"", "B", None),
        ];
        let text = exported("Ada", &sessions, Form::Csv).unwrap();
        let expected = "id,ended (UTC),scenario,folder,A [mm],B [mm]\r\n\
             1,2026-11-28 17:00,'=1+1,0001,-2.5,\r\n2,2026-11-28 17:00,\"a, \"\"b\"\"\",0001,,\r\n";
        assert_eq!(text, expected);
        let json: serde_json::Value =
            serde_json::from_str(&exported("Ada", &sessions, Form::Json).unwrap()).unwrap();
        assert_eq!(json["schema"], "osteotome.profile/1");
        assert_eq!(json["sessions"][0]["figures"]["rows"][0]["value"], -2.5);
    }
}
