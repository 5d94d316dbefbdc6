//! The case: one TOML file that says everything about a fracture problem.
use crate::scenario::{Units, explain, parse_toml, plain};
use anyhow::{Result, anyhow, bail, ensure};
use osteotome_mechanics::bone::{EngineeringConstants, Orthotropic, TetMaterial};
use osteotome_mechanics::crack::criterion::Criterion;
use osteotome_mechanics::geometry::Vec3;
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
    /// \[MPa\]; with `poisson_ratio`, or else `orthotropic` is given.
    pub young_modulus: Option<f64>,
    /// Above -1, below 0.5.
    pub poisson_ratio: Option<f64>,
    /// Nine constants in the frame of `axes`.
    pub orthotropic: Option<EngineeringConstants>,
    /// Where axes 1, 2, 3 point.
    pub axes: Option<Axes>,
    /// Critical energy release rate \[N/mm\]; without it the region does not break.
    pub toughness: Option<f64>,
    /// Critical energy release rate of a crack that stands square to axis 1; without it as `toughness`.
    pub toughness_across: Option<f64>,
}

/// A field of directions: exactly one of `first` and `along` is given.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axes {
    /// Axis 1, the same everywhere.
    pub first: Option<[f64; 3]>,
    /// A curve \[mm\]: axis 1 is its direction, blended between its segments by distance.
    pub along: Option<Vec<[f64; 3]>>,
    /// What is square to axis 1 in this vector is axis 2; axis 3 = 1 x 2.
    pub second: [f64; 3],
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
    /// Share of the twist asked for by K_III that a front takes in one step, 0 to 1.
    #[serde(default)]
    pub twist: f64,
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
            ensure!(
                (0.0..=1.0).contains(&g.twist),
                "growth.twist: {} is out of range; it must lie between 0 and 1",
                g.twist
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
        self.check_elasticity(key)?;
        if let Some(axes) = &self.axes {
            axes.check(&format!("{key}.axes"))?;
        }
        match self.toughness {
            Some(g) => positive(&format!("{key}.toughness"), g)?,
            None if grows => bail!(
                "{key}.toughness: this key is missing; growth needs the critical energy release rate [N/mm] (or growth.steps = 0)"
            ),
            None => (),
        }
        let Some(across) = self.toughness_across else {
            return Ok(());
        };
        positive(&format!("{key}.toughness_across"), across)?;
        ensure!(
            self.axes.is_some() && self.toughness.is_some(),
            "{key}.toughness_across: it is given without axes and toughness; give both, or leave it out"
        );
        Ok(())
    }

    fn check_elasticity(&self, key: &str) -> Result<()> {
        if let Some(constants) = &self.orthotropic {
            ensure!(
                self.young_modulus.is_none() && self.poisson_ratio.is_none(),
                "{key}.orthotropic: it is given beside young_modulus or poisson_ratio; give the nine constants or those two"
            );
            ensure!(
                self.axes.is_some(),
                "{key}.axes: this key is missing; orthotropic needs the directions of axes 1 and 2"
            );
            return constants
                .check()
                .map_err(|e| anyhow!("{key}.orthotropic: {e}"));
        }
        let [young, poisson] = [
            ("young_modulus", self.young_modulus),
            ("poisson_ratio", self.poisson_ratio),
        ]
        .map(|(name, value)| value.ok_or_else(|| anyhow!("{key}.{name}: this key is missing")));
        let (young, poisson) = (young?, poisson?);
        positive(&format!("{key}.young_modulus"), young)?;
        ensure!(
            poisson > -1.0 && poisson < 0.5,
            "{key}.poisson_ratio: {poisson} is out of range; it must lie between -1 and 0.5, both excluded"
        );
        Ok(())
    }

    /// The material of a tetrahedron about `centre`; must have been checked.
    ///
    /// # Errors
    /// If the curve of the axes runs along `second` there.
    pub fn at(&self, centre: &Vec3) -> Result<TetMaterial> {
        // A region without toughness never breaks; what is written here is not looked at.
        let toughness = self.toughness.unwrap_or(1.0);
        let axes = self.axes.as_ref();
        let frame = axes.map(|a| (a.first_at(centre), Vec3::from(a.second)));
        let material = match (self.orthotropic, &frame) {
            (Some(constants), Some((first, second))) => {
                let law = Orthotropic::new(&constants, first, second)?;
                TetMaterial::orthotropic(law, toughness)
            }
            _ => TetMaterial::isotropic(
                self.young_modulus.unwrap_or(1.0),
                self.poisson_ratio.unwrap_or(0.0),
                toughness,
            ),
        };
        Ok(TetMaterial {
            toughness_across: self.toughness_across.unwrap_or(toughness),
            osteon: frame.map_or(material.osteon, |f| f.0.normalize()),
            ..material
        })
    }
}

impl Axes {
    fn check(&self, key: &str) -> Result<()> {
        /// Points of a curve at most: each tetrahedron looks at all of them.
        const MOST: usize = 1000;
        finite(&format!("{key}.second"), self.second)?;
        match (&self.first, &self.along) {
            (Some(first), None) => {
                finite(&format!("{key}.first"), *first)?;
                let (one, two) = (Vec3::from(*first), Vec3::from(self.second));
                let square = one.cross(&two).norm();
                let sizes = one.norm() * two.norm();
                ensure!(
                    square > 1e-6 * sizes,
                    "{key}: first and second are parallel or zero; give two directions that are not"
                );
            }
            (None, Some(points)) => {
                finite(&format!("{key}.along"), points.iter().flatten().copied())?;
                ensure!(
                    points.len() >= 2 && points.len() <= MOST,
                    "{key}.along: it has {} points; give 2 to {MOST}",
                    points.len()
                );
                ensure!(
                    points.windows(2).all(|p| p[0] != p[1]),
                    "{key}.along: two points in a row are the same; leave one out"
                );
            }
            _ => bail!("{key}: exactly one of first, along must be given"),
        }
        Ok(())
    }

    /// Axis 1 at a point, of any length.
    fn first_at(&self, p: &Vec3) -> Vec3 {
        let along = self.along.iter().flat_map(|points| points.windows(2));
        let segments = along.map(|p| (Vec3::from(p[0]), Vec3::from(p[1])));
        let distance2 = |a: &Vec3, b: &Vec3| {
            let s = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
            (a + (b - a) * s - p).norm_squared()
        };
        // By the inverse fourth power of distance, softened by a part of the segment: the direction turns gradually at a corner.
        let blended: Vec3 = segments
            .map(|(a, b)| {
                let soft = distance2(&a, &b) + 0.01 * (b - a).norm_squared();
                (b - a).normalize() / (soft * soft)
            })
            .sum();
        self.first.map_or(blended, Vec3::from)
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
            (
                "poisson_ratio = 0.3\n",
                "",
                ["material.0.poisson_ratio", "missing"],
            ),
            (
                "toughness = 0.5\n",
                "toughness = 0.5\ntoughness_across = 2.0\n",
                ["material.0.toughness_across", "without axes"],
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
            (
                "steps = 10",
                "steps = 10\ntwist = nan",
                ["growth.twist: NaN", "between 0 and 1"],
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

    const NINE: &str = "orthotropic = { e1 = 20e3, e2 = 13e3, e3 = 11e3, nu12 = 0.3, nu23 = 0.4, nu13 = 0.3, g12 = 6e3, g23 = 4e3, g13 = 5e3 }\naxes = { first = [1, 0, 0], second = [0, 0, 1] }\n";

    fn orthotropic() -> String {
        CASE.replacen("young_modulus = 200000\npoisson_ratio = 0.3\n", NINE, 1)
    }

    #[test]
    fn orthotropic_materials_are_read_or_named() {
        let case = read(&orthotropic()).unwrap();
        let m = case.material[0].at(&Vec3::zeros()).unwrap();
        assert_eq!(m.osteon, Vec3::x());
        assert!(m.orthotropic.is_some() && m.young_modulus > 11e3 && m.young_modulus < 20e3);
        for (from, to, parts) in [
            (
                "e2 = 13e3",
                "e2 = -13e3",
                ["orthotropic: e2 is -13000", "positive"],
            ),
            ("nu12 = 0.3", "nu12 = 1.3", ["nu12 is 1.3", "sqrt(e1 / e2)"]),
            (
                "nu23 = 0.4",
                "nu23 = 1.04",
                ["nu12, nu23 and nu13 together", "above 0"],
            ),
            ("g13 = 5e3", "g13 = nan", ["g13 is NaN", "positive"]),
            (", g13 = 5e3", "", ["material.0.orthotropic.g13", "missing"]),
            (
                "second = [0, 0, 1]",
                "second = [2, 0, 0]",
                ["axes", "parallel"],
            ),
            ("first = [1, 0, 0]", "first = [0, 0, 0]", ["axes", "zero"]),
            (
                "first = [1, 0, 0], ",
                "",
                ["axes", "exactly one of first, along"],
            ),
            (
                "first = [1, 0, 0]",
                "along = [[1, 0, 0]]",
                ["along", "1 points"],
            ),
            (
                "first = [1, 0, 0]",
                "along = [[1, 0, 0], [1, 0, 0]]",
                ["along", "the same"],
            ),
            (
                "axes = {",
                "young_modulus = 3.0\naxes = {",
                ["orthotropic", "beside young_modulus"],
            ),
        ] {
            let text = orthotropic();
            assert!(text.contains(from), "{from}");
            let error = format!("{:#}", read(&text.replacen(from, to, 1)).unwrap_err());
            for part in parts {
                assert!(error.contains(part), "'{part}' is not in: {error}");
            }
        }
    }

    /// Beside the middle of each leg of an L axis 1 runs along it; at the corner it lies between the two.
    #[test]
    fn axes_follow_a_curve() {
        let axes = Axes {
            first: None,
            along: Some(vec![[0.0; 3], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0]]),
            second: [0.0, 0.0, 1.0],
        };
        let at = |x: f64, y: f64| axes.first_at(&Vec3::new(x, y, 0.5)).normalize();
        assert!(at(2.0, 0.0).x > 0.99 && at(10.0, 8.0).y > 0.99);
        let corner = at(10.0, 0.0);
        assert!((corner.x - corner.y).abs() < 1e-9, "{corner}");
    }
}
