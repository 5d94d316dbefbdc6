use anyhow::{Context, Result, bail};
use std::path::Path;
use std::str::FromStr;
use toml::{Table, Value};

/// One `--set KEY=VALUE`: a dotted key and a TOML value.
#[derive(Clone, Debug)]
pub struct Override {
    /// The key's parts; a list's element by its number.
    pub path: Vec<String>,
    value: Value,
}

impl FromStr for Override {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let (key, value) = text
            .split_once('=')
            .with_context(|| format!("--set {text}: there is no '='; write --set KEY=VALUE"))?;
        let path: Vec<_> = key.trim().split('.').map(str::to_owned).collect();
        if path.iter().any(String::is_empty) {
            bail!("--set {text}: '{key}' is not a key; write e.g. --set mesh.nodes=600");
        }
        let mut parsed: Table = format!("value = {value}").parse().map_err(|_| {
            anyhow::anyhow!(
                "--set {key}: '{value}' is not a TOML value; strings go in quotes, e.g. --set {key}='\"{}\"'",
                value.trim().trim_matches(['"', '\''])
            )
        })?;
        match parsed.remove("value") {
            Some(value) if parsed.is_empty() => Ok(Self { path, value }),
            _ => bail!("--set {key}: '{value}' is more than one TOML value"),
        }
    }
}

/// Keys of which a scenario holds one: setting it takes the others away.
const ALTERNATIVES: [(&str, &[&str]); 3] = [
    ("patient", &["parametric", "directory", "surface"]),
    ("osteotomy", &["points", "file", "technique"]),
    ("mesh", &["file", "nodes"]),
];

/// Keys that hold a path.
const PATHS: [[&str; 2]; 7] = [
    ["patient", "directory"],
    ["patient", "surface"],
    ["patient", "context"],
    ["patient", "canal"],
    ["mesh", "file"],
    ["osteotomy", "file"],
    ["material", "density"],
];
/// A path within one of those.
const SCAN: [&str; 3] = ["material", "density", "scan"];

impl Override {
    /// The key as the user wrote it.
    pub fn key(&self) -> String {
        self.path.join(".")
    }

    /// Puts the value into the scenario's tree. A relative path is meant from `working_directory`.
    ///
    /// # Errors
    /// A key that leads through something that is not a table or a list, or past a list's end.
    pub fn apply(&self, tree: &mut Table, working_directory: &Path) -> Result<()> {
        let mut value = self.value.clone();
        if PATHS.iter().any(|p| self.path == *p) || self.path == SCAN {
            make_absolute(&mut value, working_directory);
        }
        if let [section, key, ..] = self.path.as_slice() {
            drop_alternatives(tree, section, key);
        }
        let (last, way) = self.path.split_last().context("--set: an empty key")?;
        let mut root = Value::Table(std::mem::take(tree));
        let result = self
            .descend(&mut root, way)
            .and_then(|at| self.put(at, last, value));
        if let Value::Table(table) = root {
            *tree = table;
        }
        result
    }

    fn descend<'a>(&self, mut at: &'a mut Value, way: &[String]) -> Result<&'a mut Value> {
        for part in way {
            at = match at {
                Value::Table(table) => table
                    .entry(part.clone())
                    .or_insert_with(|| Value::Table(Table::new())),
                Value::Array(list) => self.element(list, part)?,
                _ => bail!("--set {}: there is nothing below '{part}'", self.key()),
            };
        }
        Ok(at)
    }

    fn put(&self, at: &mut Value, last: &str, value: Value) -> Result<()> {
        match at {
            Value::Table(table) => {
                table.insert(last.to_owned(), value);
            }
            Value::Array(list) => *self.element(list, last)? = value,
            _ => bail!(
                "--set {}: there is nothing below its parent key",
                self.key()
            ),
        }
        Ok(())
    }

    fn element<'a>(&self, list: &'a mut [Value], part: &str) -> Result<&'a mut Value> {
        let n = list.len();
        let index: Option<usize> = part.parse().ok();
        index.and_then(|i| list.get_mut(i)).with_context(|| {
            format!(
                "--set {}: '{part}' is not an element of a list of {n}; count from 0",
                self.key()
            )
        })
    }
}

fn drop_alternatives(tree: &mut Table, section: &str, key: &str) {
    for (_, keys) in ALTERNATIVES
        .iter()
        .filter(|(s, keys)| *s == section && keys.contains(&key))
    {
        if let Some(Value::Table(table)) = tree.get_mut(section) {
            for other in keys.iter().filter(|k| **k != key) {
                table.remove(*other);
            }
        }
    }
}

/// Makes the scenario file's own paths absolute: they are meant from its folder.
pub fn resolve_paths(tree: &mut Table, folder: &Path) {
    for [section, key] in PATHS {
        if let Some(value) = tree.get_mut(section).and_then(|s| s.get_mut(key)) {
            make_absolute(value, folder);
        }
    }
}

fn make_absolute(value: &mut Value, folder: &Path) {
    match value {
        Value::String(path) => *path = folder.join(&*path).display().to_string(),
        // A list of surfaces around the jaw.
        Value::Array(list) => {
            for entry in list.iter_mut().filter_map(|e| e.get_mut("surface")) {
                make_absolute(entry, folder);
            }
        }
        Value::Table(table) => {
            if let Some(scan) = table.get_mut(SCAN[2]) {
                make_absolute(scan, folder);
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(tree: &str, text: &str) -> Result<Table> {
        let mut tree: Table = tree.parse()?;
        text.parse::<Override>()?
            .apply(&mut tree, Path::new("/here"))?;
        Ok(tree)
    }

    #[test]
    fn values_are_put_where_the_key_says() {
        let tree = set(
            "[[tool]]\nname = 'a'\n[[tool]]\nname = 'b'",
            "tool.1.name='c'",
        )
        .unwrap();
        assert_eq!(tree["tool"][1]["name"].as_str(), Some("c"));
        assert_eq!(
            set("", "mesh.nodes=600").unwrap()["mesh"]["nodes"].as_integer(),
            Some(600)
        );
    }

    #[test]
    fn a_surface_takes_the_parametric_patients_place() {
        let tree = set("[patient]\nparametric = {}", "patient.surface=\"a.stl\"").unwrap();
        assert_eq!(tree["patient"]["surface"].as_str(), Some("/here/a.stl"));
        assert!(tree["patient"].get("parametric").is_none());
        let tree = set("[patient]\nparametric = {}", "patient.parametric.scale=1.1").unwrap();
        assert_eq!(tree["patient"]["parametric"]["scale"].as_float(), Some(1.1));
    }

    #[test]
    fn surfaces_around_the_jaw_are_meant_from_the_folder() {
        let tree = set(
            "",
            "patient.context=[{surface='a.stl'}, {surface='/b.stl'}]",
        )
        .unwrap();
        let surface = |i: usize| tree["patient"]["context"][i]["surface"].as_str();
        assert_eq!(surface(0), Some("/here/a.stl"));
        assert_eq!(surface(1), Some("/b.stl"));
    }

    #[test]
    fn what_cannot_be_set_is_named() {
        let error = |tree, text| set(tree, text).unwrap_err().to_string();
        assert!(error("", "mesh.nodes").contains("KEY=VALUE"));
        assert!(error("", "patient.surface=a.stl").contains("'\"a.stl\"'"));
        assert!(error("tool = [1]", "tool.3=2").contains("list of 1"));
        assert!(error("name = 'x'", "name.first='y'").contains("nothing below"));
        assert!(error("", "a=1\nb=2").contains("more than one"));
    }
}
