use super::overrides::{Override, resolve_paths};
use super::{Material, Scenario, Workspace};
use anyhow::{Context, Result, anyhow, bail, ensure};
use osteotome_anatomy::folder::read_manifest;
use std::path::{Path, PathBuf};
use toml::Table;

/// Where a scenario's text comes from.
#[derive(Clone, Debug)]
pub enum Source {
    /// A file.
    File(PathBuf),
    /// Text that came with the program or a recording, under a name for messages.
    Text {
        /// What messages call it.
        name: String,
        /// The TOML.
        text: String,
    },
}

impl Source {
    fn name(&self) -> String {
        match self {
            Self::File(path) => path.display().to_string(),
            Self::Text { name, .. } => name.clone(),
        }
    }

    fn text(&self) -> Result<String> {
        match self {
            Self::File(path) => std::fs::read_to_string(path).map_err(|e| {
                anyhow!(
                    "{}: {}; give the path of a scenario (TOML)",
                    path.display(),
                    plain(&e)
                )
            }),
            Self::Text { text, .. } => Ok(text.clone()),
        }
    }

    fn folder(&self, working_directory: &Path) -> PathBuf {
        match self {
            Self::File(path) => working_directory.join(path.parent().unwrap_or(Path::new(""))),
            Self::Text { .. } => working_directory.to_owned(),
        }
    }
}

/// An I/O error's text without the "(os error N)".
pub fn plain(error: &std::io::Error) -> String {
    let text = error.to_string();
    text.split(" (os error")
        .next()
        .unwrap_or(&text)
        .to_lowercase()
}

/// Reads, overrides and checks a scenario.
///
/// # Errors
/// One line: where (file, key), what, and what would be right.
pub fn load(source: &Source, overrides: &[Override], working_directory: &Path) -> Result<Scenario> {
    let name = source.name();
    let mut tree = parse_toml(&source.text()?, &name)?;
    resolve_paths(&mut tree, &source.folder(working_directory));
    for o in overrides {
        o.apply(&mut tree, working_directory)?;
    }
    take_prepared_nodes(&mut tree);
    let place = |key: &str| {
        let set = overrides
            .iter()
            .any(|o| key == o.key() || key.starts_with(&(o.key() + ".")));
        if set {
            format!("--set {key}")
        } else {
            format!("{name}: {key}")
        }
    };
    let scenario: Scenario = serde_path_to_error::deserialize(tree)
        .map_err(|e| explain(&e.path().to_string(), e.inner(), &place))?;
    validate(&scenario, &place)?;
    Ok(scenario)
}

/// Without `mesh.nodes` a prepared patient's mesh is taken as it is: the tree is given the number with which it was made. A folder
/// that cannot be read is named later, with its key.
fn take_prepared_nodes(tree: &mut Table) {
    let directory = tree.get("patient").and_then(|p| p.get("directory"));
    let Some(folder) = directory.and_then(toml::Value::as_str) else {
        return;
    };
    let Ok(manifest) = read_manifest(Path::new(folder)) else {
        return;
    };
    let mesh = tree.entry("mesh").or_insert_with(|| Table::new().into());
    if let Some(mesh) = mesh.as_table_mut()
        && !mesh.contains_key("file")
    {
        let target = i64::try_from(manifest.mesh.target).unwrap_or(i64::MAX);
        mesh.entry("nodes").or_insert(target.into());
    }
}

/// TOML as a tree; what is no TOML is named by line.
///
/// # Errors
/// One line that begins with `name`.
pub fn parse_toml(text: &str, name: &str) -> Result<Table> {
    text.parse::<Table>().map_err(|e| {
        let line = e
            .span()
            .map(|s| 1 + text[..s.start.min(text.len())].matches('\n').count());
        let message = e.message().replace('\n', ", ");
        match line {
            Some(line) => anyhow!("{name}, line {line}: not valid TOML: {message}"),
            None => anyhow!("{name}: not valid TOML: {message}"),
        }
    })
}

/// Serde's complaint as one line; an unknown key is answered with the nearest right one.
pub fn explain(
    path: &str,
    error: &toml::de::Error,
    place: &impl Fn(&str) -> String,
) -> anyhow::Error {
    let path = path.replace('[', ".").replace(']', "");
    let message = error.message().replace('\n', ", ");
    let names: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let Some((unknown, known)) = names.split_first() else {
        return anyhow!("{}: {message}", place(&path));
    };
    if message.starts_with("missing field") {
        let key = if path == "." {
            (*unknown).to_owned()
        } else {
            format!("{path}.{unknown}")
        };
        return anyhow!("{}: this key is missing", place(&key));
    }
    if !message.starts_with("unknown field") && !message.starts_with("unknown variant") {
        return anyhow!("{}: {message}", place(&path));
    }
    let is_field = message.starts_with("unknown field");
    let nearest = known.iter().max_by(|a, b| {
        strsim::jaro_winkler(unknown, a).total_cmp(&strsim::jaro_winkler(unknown, b))
    });
    let what = if is_field {
        format!("unknown key '{unknown}'")
    } else {
        format!("unknown value \"{unknown}\"")
    };
    let mend = nearest.map_or_else(
        || "no key is known here".to_owned(),
        |n| format!("did you mean '{n}'? (known: {})", known.join(", ")),
    );
    anyhow!("{}: {what}; {mend}", place(&path))
}

/// Checks that no type can express.
fn validate(s: &Scenario, place: &impl Fn(&str) -> String) -> Result<()> {
    let at = Checks { place };
    at.positive("max_time", s.max_time)?;
    at.patient(s)?;
    at.osteotomy(s)?;
    at.material("material.cortical", &s.material.cortical)?;
    at.material("material.trabecular", &s.material.trabecular)?;
    if let Some(nine) = &s.material.cortical_orthotropic {
        let key = "material.cortical_orthotropic";
        nine.check().map_err(|e| anyhow!("{}: {e}", place(key)))?;
    }
    at.positive("material.cortical_thickness", s.material.cortical_thickness)?;
    if let Some(regions) = &s.material.cortical_regions {
        let key = "material.cortical_regions";
        regions
            .check()
            .map_err(|e| anyhow!("{}: {e}", place(key)))?;
    }
    let scan = s.material.density.as_ref().map(|d| d.scan.as_path());
    at.existing("material.density.scan", scan)?;
    at.count("mesh.nodes", s.mesh.nodes, 100, 200_000)?;
    at.range("mesh.grading", s.mesh.grading, 1.0, 6.0)?;
    at.count("mesh.shell_points", s.mesh.shell_points, 1000, 1_000_000)?;
    at.existing("mesh.file", s.mesh.file.as_deref())?;
    at.positive("supports.soft_tissue", s.supports.soft_tissue)?;
    at.positive("contact.stiffness", s.contact.stiffness)?;
    at.range("contact.friction", s.contact.friction, 0.0, 2.0)?;
    at.tools(s)?;
    at.surgeon(s)?;
    at.targets(s)?;
    at.view(s)?;
    at.loops(s)
}

struct Checks<'a, P> {
    place: &'a P,
}

impl<P: Fn(&str) -> String> Checks<'_, P> {
    fn positive(&self, key: &str, value: f64) -> Result<()> {
        ensure!(
            value > 0.0 && value.is_finite(),
            "{}: {value} is out of range; it must be a finite number above 0",
            (self.place)(key)
        );
        Ok(())
    }

    fn range(&self, key: &str, value: f64, least: f64, most: f64) -> Result<()> {
        ensure!(
            (least..=most).contains(&value),
            "{}: {value} is out of range; it must be between {least} and {most}",
            (self.place)(key)
        );
        Ok(())
    }

    fn count(&self, key: &str, value: usize, least: usize, most: usize) -> Result<()> {
        ensure!(
            (least..=most).contains(&value),
            "{}: {value} is out of range; it must be between {least} and {most}",
            (self.place)(key)
        );
        Ok(())
    }

    fn one_of(&self, section: &str, given: &[(&str, bool)]) -> Result<()> {
        let names: Vec<_> = given
            .iter()
            .filter(|(_, is)| *is)
            .map(|(n, _)| *n)
            .collect();
        let all: Vec<_> = given.iter().map(|(n, _)| *n).collect();
        let found = match names.as_slice() {
            [_] => return Ok(()),
            [] => "none is given".to_owned(),
            several => format!("{} are given together", several.join(" and ")),
        };
        bail!(
            "{}: {found}; give exactly one of {}",
            (self.place)(section),
            all.join(", ")
        )
    }

    fn existing(&self, key: &str, path: Option<&Path>) -> Result<()> {
        let Some(path) = path else { return Ok(()) };
        let found = std::fs::metadata(path)
            .map_err(|e| plain(&e))
            .and_then(|m| {
                if m.is_file() {
                    Ok(())
                } else {
                    Err("is not a file".to_owned())
                }
            });
        found.map_err(|what| {
            anyhow!(
                "{}: {}: {what}; give an existing file",
                (self.place)(key),
                path.display()
            )
        })
    }

    fn patient(&self, s: &Scenario) -> Result<()> {
        let p = &s.patient;
        let given = [
            ("parametric", p.parametric.is_some()),
            ("directory", p.directory.is_some()),
            ("surface", p.surface.is_some()),
        ];
        self.one_of("patient", &given)?;
        if let Some(sizes) = &p.parametric {
            sizes.check().map_err(|e| {
                let text = e.to_string();
                let key = text.split(' ').next().unwrap_or("patient.parametric");
                anyhow!("{}: {text}", (self.place)(key))
            })?;
        }
        if let Some(folder) = &p.directory {
            read_manifest(folder)
                .map_err(|e| anyhow!("{}: {e}", (self.place)("patient.directory")))?;
        }
        for (i, c) in p.context.iter().enumerate() {
            self.existing(&format!("patient.context.{i}.surface"), Some(&c.surface))?;
        }
        self.existing("patient.canal", p.canal.as_deref())?;
        self.existing("patient.surface", p.surface.as_deref())
    }

    fn osteotomy(&self, s: &Scenario) -> Result<()> {
        let o = &s.osteotomy;
        let given = [
            ("points", o.points.is_some()),
            ("file", o.file.is_some()),
            ("technique", o.technique.is_some()),
        ];
        self.one_of("osteotomy", &given)?;
        self.range("osteotomy.kerf", o.kerf, 0.1, 5.0)?;
        self.existing("osteotomy.file", o.file.as_deref())?;
        if o.technique.is_some() && s.patient.surface.is_some() {
            bail!(
                "{}: a technique needs landmarks, which a surface alone has not; give osteotomy.file or osteotomy.points",
                (self.place)("osteotomy.technique")
            );
        }
        for (i, p) in o.points.iter().flatten().enumerate() {
            let key = format!("osteotomy.points.{i}");
            self.positive(&format!("{key}.depth"), p.depth)?;
            let length = p.toward.iter().map(|c| c * c).sum::<f64>().sqrt();
            self.positive(&format!("{key}.toward (its length)"), length)?;
            let all_finite = p.at.iter().all(|c| c.is_finite());
            ensure!(
                all_finite,
                "{}: {:?} is not a place; give three finite numbers",
                (self.place)(&format!("{key}.at")),
                p.at
            );
        }
        Ok(())
    }

    fn material(&self, key: &str, m: &Material) -> Result<()> {
        self.positive(&format!("{key}.young_modulus"), m.young_modulus)?;
        self.range(&format!("{key}.poisson_ratio"), m.poisson_ratio, 0.0, 0.49)?;
        self.positive(&format!("{key}.toughness.0"), m.toughness[0])?;
        self.positive(&format!("{key}.toughness.1"), m.toughness[1])
    }

    fn tools(&self, s: &Scenario) -> Result<()> {
        let names: Vec<_> = s.tool.iter().map(|t| t.name.as_str()).collect();
        ensure!(
            names == ["left", "right"],
            "{}: the tools are named {names:?}; give two, \"left\" first, then \"right\"",
            (self.place)("tool")
        );
        for (i, t) in s.tool.iter().enumerate() {
            for (key, value) in [
                ("force_scale", t.force_scale),
                ("torque_scale", t.torque_scale),
                ("limits.force", t.limits.force),
                ("limits.torque", t.limits.torque),
                ("limits.force_rate", t.limits.force_rate),
                ("limits.torque_rate", t.limits.torque_rate),
                ("coupling.linear_stiffness", t.coupling.linear_stiffness),
                ("coupling.angular_stiffness", t.coupling.angular_stiffness),
            ] {
                self.positive(&format!("tool.{i}.{key}"), value)?;
            }
            for (key, value, [least, most]) in [
                ("width", t.chisel.width, [2.0, 30.0]),
                ("thickness", t.chisel.thickness, [1.0, 8.0]),
                ("bevel_deg", t.chisel.bevel_deg, [8.0, 90.0]),
                ("length", t.chisel.length, [20.0, 150.0]),
            ] {
                self.range(&format!("tool.{i}.chisel.{key}"), value, least, most)?;
            }
            self.workspace(&format!("tool.{i}.workspace"), &t.workspace)?;
            osteotome_devices::SimulatedHand::new(
                t.hand_parameters(),
                osteotome_devices::Pose::identity(),
                s.loops.dt(),
            )
            .map_err(|e| anyhow!("{e}"))
            .with_context(|| (self.place)(&format!("tool.{i}")))?;
        }
        Ok(())
    }

    fn workspace(&self, key: &str, w: &Workspace) -> Result<()> {
        self.range(&format!("{key}.scale"), w.scale, 0.05, 20.0)?;
        for (name, angles) in [
            ("rotation_deg", w.rotation_deg),
            ("handle_deg", w.handle_deg),
        ] {
            for angle in angles {
                self.range(&format!("{key}.{name}"), angle, -360.0, 360.0)?;
            }
        }
        let button = f64::from(w.clutch_button.unwrap_or(0));
        self.range(&format!("{key}.clutch_button"), button, 0.0, 31.0)?;
        let lever = w.torque_lever.unwrap_or(10.0);
        self.range(&format!("{key}.torque_lever"), lever, 10.0, 500.0)
    }

    fn surgeon(&self, s: &Scenario) -> Result<()> {
        let g = &s.surgeon;
        for (i, station) in g.stations.iter().enumerate() {
            self.range(&format!("surgeon.stations.{i}"), *station, 0.0, 1.0)?;
        }
        for (key, value) in [
            ("approach_distance", g.approach_distance),
            ("approach_speed", g.approach_speed),
            ("drive_speed", g.drive_speed),
            ("twist_rate_deg", g.twist_rate_deg),
            ("max_depth", g.max_depth),
            ("stall_time", g.stall_time),
            ("reaction_time", g.reaction_time),
            ("relax_time", g.relax_time),
        ] {
            self.positive(&format!("surgeon.{key}"), value)?;
        }
        for (key, value, most) in [
            ("insert_depth", g.insert_depth, 1.0),
            ("twist_max_deg", g.twist_max_deg, 90.0),
            ("behind_front", g.behind_front, 50.0),
            ("wedge", g.wedge, 50.0),
            ("push_share", g.push_share, 1.0),
            ("force_share", g.force_share, 1.0),
            ("variation", g.variation, 0.5),
        ] {
            self.range(&format!("surgeon.{key}"), value, 0.0, most)?;
        }
        Ok(())
    }

    fn targets(&self, s: &Scenario) -> Result<()> {
        const MOST: f64 = 1e6;
        let t = &s.targets;
        self.range("targets.complete", t.complete, 0.0, MOST)?;
        self.range("targets.no_bad_split", t.no_bad_split, 0.0, MOST)?;
        for (key, target) in t.scaled() {
            let key = format!("targets.{key}");
            self.range(&format!("{key}.weight"), target.weight, 0.0, MOST)?;
            self.range(&format!("{key}.good"), target.good, -MOST, MOST)?;
            self.range(&format!("{key}.bad"), target.bad, -MOST, MOST)?;
            ensure!(
                target.good != target.bad,
                "{}: good and bad are both {}; they must differ",
                (self.place)(&key),
                target.good
            );
        }
        Ok(())
    }

    fn view(&self, s: &Scenario) -> Result<()> {
        if let Some(mm) = s.view.eye_separation {
            self.range("view.eye_separation", mm, 0.0, 200.0)?;
        }
        if let Some(mm) = s.view.convergence {
            self.range("view.convergence", mm, 10.0, 10_000.0)?;
        }
        if let Some(n) = s.view.views {
            self.count("view.views", n, 2, 16)?;
        }
        Ok(())
    }

    fn loops(&self, s: &Scenario) -> Result<()> {
        self.range("loops.haptic_hz", s.loops.haptic_hz, 100.0, 10_000.0)?;
        self.range("loops.main_hz", s.loops.main_hz, 1.0, s.loops.haptic_hz)?;
        let ratio = s.loops.haptic_hz / s.loops.main_hz;
        ensure!(
            (ratio - ratio.round()).abs() < 1e-9,
            "{}: {} does not divide loops.haptic_hz = {}; give e.g. {}",
            (self.place)("loops.main_hz"),
            s.loops.main_hz,
            s.loops.haptic_hz,
            s.loops.haptic_hz / ratio.round()
        );
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::{BSSO_LEFT, BSSO_RIGHT, Side};
    use super::*;

    fn with(sets: &[&str]) -> Result<Scenario> {
        text(BSSO_RIGHT, sets)
    }

    fn text(text: &str, sets: &[&str]) -> Result<Scenario> {
        let source = Source::Text {
            name: "s.toml".to_owned(),
            text: text.to_owned(),
        };
        let overrides = sets.iter().map(|s| s.parse()).collect::<Result<Vec<_>>>()?;
        load(&source, &overrides, Path::new("/"))
    }

    fn check_error(sets: &[&str], parts: &[&str]) {
        let message = format!("{:#}", with(sets).unwrap_err());
        assert!(!message.contains('\n'), "one line: {message}");
        for part in parts {
            assert!(message.contains(part), "'{part}' is not in: {message}");
        }
    }

    #[test]
    fn the_shipped_scenarios_are_right() {
        let right = with(&[]).unwrap();
        assert_eq!((right.osteotomy.side, right.mesh.nodes), (Side::Right, 600));
        assert_eq!(text(BSSO_LEFT, &[]).unwrap().osteotomy.side, Side::Left);
    }

    #[test]
    fn a_scenario_survives_json() {
        let scenario = with(&[]).unwrap();
        let json = serde_json::to_string(&scenario).unwrap();
        let back: Scenario = serde_json::from_str(&json).unwrap();
        assert_eq!(serde_json::to_string(&back).unwrap(), json);
    }

    #[test]
    fn wrong_input_is_named_with_its_place_and_mend() {
        check_error(
            &["mesh.nodez=3"],
            &["--set mesh.nodez", "unknown key 'nodez'", "'nodes'"],
        );
        check_error(&["tool.0.chisel.widht=3"], &["tool.0.chisel", "'width'"]);
        check_error(
            &["material.cortical.young_modulus=-1"],
            &["--set material.cortical.young_modulus", "-1", "above 0"],
        );
        check_error(
            &["material.cortical.toughness.1=nan"],
            &["toughness.1", "NaN"],
        );
        check_error(
            &[
                "material.cortical_orthotropic={e1=2e4,e2=1e4,e3=1e4,nu12=1.5,nu23=0.3,nu13=0.3,g12=5e3,g23=4e3,g13=5e3}",
            ],
            &[
                "material.cortical_orthotropic",
                "nu12 is 1.5",
                "positive definite",
            ],
        );
        check_error(&["units=\"cm\""], &["units", "\"cm\"", "mm-N-MPa"]);
        check_error(
            &["patient.surface=\"none.stl\""],
            &["/none.stl", "no such file"],
        );
        check_error(&["patient={}"], &["patient", "none is given", "parametric"]);
        check_error(
            &[
                "osteotomy.points=[]",
                "osteotomy={side=\"left\", points=[], file=\"a\"}",
            ],
            &["points and file"],
        );
        check_error(&["view.convergence=3"], &["view.convergence", "10"]);
        check_error(&["view.views=1"], &["view.views", "2 and 16"]);
        check_error(&["view.eye_separation=-1"], &["view.eye_separation", "0"]);
        check_error(&["loops.main_hz=30"], &["loops.main_hz", "does not divide"]);
        check_error(&["tool.0.hand.mass=0"], &["tool.0", "hand.mass is 0"]);
        check_error(&["mesh.nodes=\"many\""], &["mesh.nodes", "invalid type"]);
        check_error(&["tool.0.name=\"top\""], &["tool", "top", "\"left\" first"]);
        check_error(
            &["tool.1.device=\"phantom\""],
            &["--set tool.1.device", "\"phantom\"", "openhaptics[:SERIAL]"],
        );
        check_error(
            &["tool.0.workspace={scale=0}"],
            &["tool.0.workspace.scale", "0 is out of range"],
        );
        check_error(&["osteotomy={kerf=1.0}"], &["osteotomy.side", "missing"]);
    }

    #[test]
    fn broken_toml_is_named_by_line() {
        let message = text("units = 1\nname = \n", &[]).unwrap_err().to_string();
        assert!(
            message.starts_with("s.toml, line 2: not valid TOML"),
            "{message}"
        );
    }
}
