//! The case: one TOML file that says everything about a fracture problem.
use crate::scenario::{Units, explain, parse_toml, plain};
use anyhow::{Result, anyhow, bail, ensure};
use osteotome_mechanics::crack::criterion::Criterion;
use serde::Deserialize;
use std::io::Read;
use std::path::{Path, PathBuf};

/// A case's whole description.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Case {
    /// Always `mm-N-MPa`.
    #[serde(rename = "units")]
    _units: Units,
    /// The body.
    pub mesh: MeshSection,
    /// Materials by region; of those that name the same tetrahedron the last counts.
    pub material: Vec<Material>,
    /// The crack to start from.
    pub crack: Option<CrackSection>,
    /// Prescribed displacements; of those that name the same node and axis the last counts.
    #[serde(default)]
    pub support: Vec<Support>,
    /// Loads on the boundary; they add up.
    #[serde(default)]
    pub load: Vec<Load>,
    /// Whether and how the crack grows.
    pub growth: Option<Growth>,
}

/// Where the mesh is.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeshSection {
    /// .msh or .vtu.
    pub file: PathBuf,
}

/// Where the crack is.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CrackSection {
    /// .stl, .ply or .obj.
    pub surface: PathBuf,
}

/// The material of a region.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// A physical volume's name or number; `*` for all.
    pub region: String,
    /// \[MPa\]
    pub young_modulus: f64,
    /// Above -1, below 0.5.
    pub poisson_ratio: f64,
    /// Critical energy release rate \[N/mm\]; without it the region does not break.
    pub toughness: Option<f64>,
}

/// A part of the body: exactly one of the two is given.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Place {
    /// Two opposite corners \[mm\].
    #[serde(rename = "box")]
    pub bounds: Option<[[f64; 3]; 2]>,
    /// A physical surface's name or number.
    pub surface: Option<String>,
}

/// Prescribed displacements of the nodes of a place.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Support {
    /// Which nodes.
    #[serde(rename = "where")]
    pub place: Place,
    /// What is prescribed.
    pub fix: Fix,
}

/// Displacements \[mm\]; axes that are left out are free.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fix {
    /// Along x.
    pub x: Option<f64>,
    /// Along y.
    pub y: Option<f64>,
    /// Along z.
    pub z: Option<f64>,
}

impl Fix {
    /// By axis.
    pub fn axes(&self) -> [Option<f64>; 3] {
        [self.x, self.y, self.z]
    }
}

/// A load on the boundary faces of a place: exactly one of the three kinds is given.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Load {
    /// Which faces.
    #[serde(rename = "where")]
    pub place: Place,
    /// \[MPa\]
    pub traction: Option<[f64; 3]>,
    /// In all \[N\].
    pub force: Option<[f64; 3]>,
    /// About an axis.
    pub torque: Option<Torque>,
}

/// A torque.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Torque {
    /// Its direction; any length.
    pub axis: [f64; 3],
    /// A point of the axis \[mm\].
    pub origin: [f64; 3],
    /// In all \[N mm\].
    pub moment: f64,
}

/// How the crack grows.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Growth {
    /// Growth steps at most; 0 to evaluate only.
    pub steps: usize,
    /// Direction and strength.
    #[serde(default)]
    pub criterion: CriterionName,
    /// Largest advance in one step \[mm\]; without it 0.8 element sizes.
    pub increment: Option<f64>,
    /// Whether the load follows the crack.
    #[serde(default)]
    pub load: LoadControl,
}

/// Criteria by name.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CriterionName {
    /// Maximum strain energy release rate.
    #[default]
    Mserrc,
    /// Maximum tangential stress.
    Mts,
}

impl CriterionName {
    /// The criterion itself.
    pub fn criterion(self) -> Criterion {
        match self {
            Self::Mserrc => Criterion::EnergyRelease,
            Self::Mts => Criterion::HoopStress,
        }
    }
}

/// What the load does while the crack grows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LoadControl {
    /// At each step as large as makes the largest G reach G_c.
    #[default]
    Scaled,
    /// As given.
    Fixed,
}

/// Longest case file \[bytes\].
const MAX_BYTES: u64 = 1 << 20;
/// Most growth steps.
const MAX_STEPS: usize = 1000;

impl Case {
    /// Reads and checks a case; its paths become relative to where the program runs.
    ///
    /// # Errors
    /// One line: where (file, key), what, and what would be right.
    pub fn load(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let tree = parse_toml(&read_text(path)?, &name)?;
        let place = |key: &str| format!("{name}: {key}");
        let mut case: Self = serde_path_to_error::deserialize(tree)
            .map_err(|e| explain(&e.path().to_string(), e.inner(), &place))?;
        case.check().map_err(|e| anyhow!("{name}: {e:#}"))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        case.mesh.file = folder.join(&case.mesh.file);
        if let Some(crack) = &mut case.crack {
            crack.surface = folder.join(&crack.surface);
        }
        Ok(case)
    }

    /// Growth steps asked for.
    pub fn steps(&self) -> usize {
        self.growth.as_ref().map_or(0, |g| g.steps)
    }

    fn check(&self) -> Result<()> {
        ensure!(
            !self.material.is_empty(),
            "material: none is given; give at least one [[material]], region = \"*\" for all"
        );
        for (i, m) in self.material.iter().enumerate() {
            m.check(&format!("material.{i}"), self.steps() > 0)?;
        }
        for (i, s) in self.support.iter().enumerate() {
            let key = format!("support.{i}");
            s.place.check(&format!("{key}.where"))?;
            finite(&format!("{key}.fix"), s.fix.axes().into_iter().flatten())?;
            ensure!(
                s.fix.axes().iter().any(Option::is_some),
                "{key}.fix: no axis is given; give at least one of x, y, z"
            );
        }
        for (i, l) in self.load.iter().enumerate() {
            l.check(&format!("load.{i}"))?;
        }
        if let Some(g) = &self.growth {
            ensure!(
                g.steps <= MAX_STEPS,
                "growth.steps: {} is out of range; it must be at most {MAX_STEPS}",
                g.steps
            );
            if let Some(increment) = g.increment {
                positive("growth.increment", increment)?;
            }
            ensure!(
                g.steps == 0 || self.crack.is_some(),
                "growth.steps: there is no crack to grow; give [crack] or steps = 0"
            );
        }
        Ok(())
    }
}

impl Material {
    fn check(&self, key: &str, grows: bool) -> Result<()> {
        positive(&format!("{key}.young_modulus"), self.young_modulus)?;
        ensure!(
            self.poisson_ratio > -1.0 && self.poisson_ratio < 0.5,
            "{key}.poisson_ratio: {} is out of range; it must lie between -1 and 0.5, both excluded",
            self.poisson_ratio
        );
        match self.toughness {
            Some(g) => positive(&format!("{key}.toughness"), g),
            None if grows => bail!(
                "{key}.toughness: this key is missing; growth needs the critical energy release rate [N/mm] (or growth.steps = 0)"
            ),
            None => Ok(()),
        }
    }
}

impl Place {
    fn check(&self, key: &str) -> Result<()> {
        match (&self.bounds, &self.surface) {
            (Some(_), Some(_)) => {
                bail!("{key}: box and surface are given together; give exactly one of them")
            }
            (None, None) => bail!("{key}: none is given; give exactly one of box, surface"),
            (Some(b), None) => finite(&format!("{key}.box"), b.iter().flatten().copied()),
            (None, Some(_)) => Ok(()),
        }
    }
}

impl Load {
    fn check(&self, key: &str) -> Result<()> {
        self.place.check(&format!("{key}.where"))?;
        let given = [
            self.traction.is_some(),
            self.force.is_some(),
            self.torque.is_some(),
        ];
        let n = given.iter().filter(|g| **g).count();
        ensure!(
            n == 1,
            "{key}: {n} kinds of load are given; give exactly one of traction, force, torque"
        );
        finite(
            &format!("{key}.traction"),
            self.traction.iter().flatten().copied(),
        )?;
        finite(
            &format!("{key}.force"),
            self.force.iter().flatten().copied(),
        )?;
        if let Some(t) = &self.torque {
            let key = format!("{key}.torque");
            finite(&key, t.axis.into_iter().chain(t.origin).chain([t.moment]))?;
            let length = t.axis.iter().map(|c| c * c).sum::<f64>().sqrt();
            ensure!(
                length > 1e-12 && length.is_finite(),
                "{key}.axis: it has no direction; give a vector that is not zero"
            );
        }
        Ok(())
    }
}

fn positive(key: &str, value: f64) -> Result<()> {
    ensure!(
        value > 0.0 && value.is_finite(),
        "{key}: {value} is out of range; it must be a finite number above 0"
    );
    Ok(())
}

/// Beyond this a number in a case is a slip, and its square no longer safe.
const LARGEST: f64 = 1e100;

fn finite(key: &str, values: impl IntoIterator<Item = f64>) -> Result<()> {
    for v in values {
        ensure!(
            v.abs() <= LARGEST,
            "{key}: {v} is out of range; it must be a finite number"
        );
    }
    Ok(())
}

fn read_text(path: &Path) -> Result<String> {
    let shown = path.display();
    let fail = |what: &str| anyhow!("{shown}: {what}; give the path of a case (TOML)");
    let metadata = std::fs::metadata(path).map_err(|e| fail(&plain(&e)))?;
    if !metadata.is_file() {
        return Err(fail("it is not a regular file"));
    }
    let file = std::fs::File::open(path).map_err(|e| fail(&plain(&e)))?;
    let mut bytes = Vec::new();
    file.take(MAX_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| fail(&plain(&e)))?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(fail("it is larger than 1 MB"));
    }
    String::from_utf8(bytes).map_err(|_| fail("it is not text (UTF-8)"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CASE: &str = r#"units = "mm-N-MPa"
[mesh]
file = "block.msh"
[[material]]
region = "*"
young_modulus = 200000
poisson_ratio = 0.3
toughness = 0.5
[crack]
surface = "crack.stl"
[[support]]
where = { box = [[-1, -1, -1], [1, 1, -0.99]] }
fix = { x = 0.0, z = 0.0 }
[[load]]
where = { surface = "top" }
traction = [0.0, 0.0, 1.0]
[growth]
steps = 10
criterion = "mserrc"
increment = 1.0
load = "scaled"
"#;

    fn read(text: &str) -> Result<Case> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.toml");
        std::fs::write(&path, text).unwrap();
        Case::load(&path)
    }

    #[test]
    fn the_contract_s_example_is_right() {
        let case = read(CASE).unwrap();
        assert_eq!(case.steps(), 10);
        assert!(case.mesh.file.ends_with("block.msh") && case.mesh.file.is_absolute());
        assert_eq!(case.support[0].fix.axes(), [Some(0.0), None, Some(0.0)]);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_place_and_mend() {
        for (from, to, parts) in [
            ("mm-N-MPa", "m-N-Pa", ["units", "mm-N-MPa"]),
            (
                "young_modulus = 200000",
                "young_modulus = nan",
                ["material.0.young_modulus", "NaN"],
            ),
            (
                "young_modulus = 200000",
                "young_modulus = inf",
                ["material.0.young_modulus", "inf"],
            ),
            (
                "poisson_ratio = 0.3",
                "poisson_ratio = 0.5",
                ["material.0.poisson_ratio", "0.5 is out"],
            ),
            ("toughness = 0.5\n", "", ["material.0.toughness", "growth"]),
            (
                "toughness = 0.5",
                "toughness = 0",
                ["material.0.toughness", "above 0"],
            ),
            (
                "toughness",
                "toughnes",
                ["unknown key 'toughnes'", "'toughness'"],
            ),
            (
                "fix = { x = 0.0, z = 0.0 }",
                "fix = {}",
                ["support.0.fix", "at least one"],
            ),
            (
                "fix = { x = 0.0, z = 0.0 }",
                "fix = { x = nan }",
                ["support.0.fix", "NaN"],
            ),
            (
                "{ surface = \"top\" }",
                "{}",
                ["load.0.where", "exactly one of box, surface"],
            ),
            (
                "traction = [0.0, 0.0, 1.0]",
                "",
                ["load.0", "exactly one of traction"],
            ),
            (
                "traction = [0.0, 0.0, 1.0]",
                "traction = [0.0, 1.0]",
                ["load.0.traction", "length"],
            ),
            (
                "traction = [0.0, 0.0, 1.0]",
                "traction = [0.0, inf, 1.0]",
                ["load.0.traction", "inf"],
            ),
            (
                "traction = [0.0, 0.0, 1.0]",
                "torque = { axis = [0,0,0], origin = [0,0,0], moment = 1 }",
                ["axis", "direction"],
            ),
            ("steps = 10", "steps = -1", ["growth.steps", "-1"]),
            ("steps = 10", "steps = 100000", ["growth.steps", "1000"]),
            (
                "increment = 1.0",
                "increment = 0",
                ["growth.increment", "above 0"],
            ),
            ("\"scaled\"", "\"rising\"", ["growth.load", "scaled"]),
            ("\"mserrc\"", "\"hoop\"", ["growth.criterion", "mserrc"]),
            (
                "[crack]\nsurface = \"crack.stl\"\n",
                "",
                ["growth.steps", "no crack"],
            ),
            ("[mesh]\nfile = \"block.msh\"\n", "", ["mesh", "missing"]),
            (
                "steps = 10",
                "steps = 10\nsteps = 10",
                ["line 19", "duplicate"],
            ),
        ] {
            assert!(CASE.contains(from), "{from}");
            let error = format!("{:#}", read(&CASE.replacen(from, to, 1)).unwrap_err());
            assert!(!error.contains('\n'), "{error}");
            assert!(error.contains("c.toml"), "{error}");
            for part in parts {
                assert!(error.contains(part), "'{part}' is not in: {error}");
            }
        }
    }
}
