//! Planning the saw's line on a patient, without a window: what a mouse or a command asks for, and what is written at the end.
use crate::engine::{Prepared, material_spec};
use crate::scenario::{self, Scenario};
use anyhow::{Context, Result, ensure};
use osteotome_anatomy::landmarks::cast;
use osteotome_anatomy::osteotomy::plan::{FREE_DEPTH, middle_of_sight};
use osteotome_anatomy::osteotomy::{Plan, Review, Situation};
use osteotome_anatomy::{
    AnatomyError, Canal, JawFrame, Landmarks, MaterialSpec, Osteotomy, Side, Technique,
    canal::MEAN_DIAMETER,
};
use osteotome_mechanics::geometry::{MeshDistance, Vec3};
use osteotome_render::Camera;
use std::path::{Path, PathBuf};

/// A line in the making on one patient.
pub struct Planning {
    plan: Plan,
    review: Review,
    surface: MeshDistance,
    canals: Vec<Canal>,
    /// Whether the canal of the plan's side was drawn here.
    is_drawn: bool,
    frame: JawFrame,
    landmarks: Option<Landmarks>,
    material: MaterialSpec,
}

impl Planning {
    /// From the line that the patient has.
    pub fn new(prepared: &Prepared, scenario: &Scenario) -> Self {
        let patient = &prepared.patient;
        let mut planning = Self {
            plan: Plan::of(&patient.osteotomy),
            review: Review {
                points: Vec::new(),
                faults: Vec::new(),
                remarks: Vec::new(),
                canal_is_constructed: None,
            },
            surface: MeshDistance::new(patient.surface.clone()),
            canals: patient.canals.clone(),
            is_drawn: false,
            frame: patient.frame.clone(),
            landmarks: patient.landmarks.clone(),
            material: material_spec(scenario),
        };
        planning.look();
        planning
    }

    fn look(&mut self) {
        let cortex = |p: &Vec3| self.material.cortex_at(p, &self.surface, &self.frame);
        self.review = self.plan.review(&Situation {
            surface: &self.surface,
            canals: &self.canals,
            cortical_thickness: &cortex,
        });
    }

    /// The line.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// What is to be said of it.
    pub fn review(&self) -> &Review {
        &self.review
    }

    /// The canal on the line's side.
    pub fn canal(&self) -> Option<&Canal> {
        self.canals.iter().find(|c| c.side == self.plan.side)
    }

    /// Whether techniques can be placed.
    pub fn has_landmarks(&self) -> bool {
        self.landmarks.is_some()
    }

    /// Takes another line.
    pub fn set(&mut self, plan: Plan) {
        self.plan = plan;
        self.look();
    }

    /// Width of the saw cut \[mm\].
    pub fn set_kerf(&mut self, kerf: f64) {
        self.plan.kerf = kerf;
        self.look();
    }

    /// A technique's line on the same side.
    ///
    /// # Errors
    /// Without landmarks, or where they do not belong to the surface.
    pub fn by_technique(&mut self, technique: Technique) -> Result<()> {
        let landmarks = self.landmarks.as_ref();
        let landmarks = landmarks.context("a technique needs landmarks, which this patient has not; prepare it with --landmarks, or drag points")?;
        let (side, kerf) = (self.plan.side, self.plan.kerf);
        let line = Osteotomy::by_technique(technique, landmarks, side, kerf, &self.surface)?;
        self.set(Plan::of(&line));
        Ok(())
    }

    /// Along free points.
    ///
    /// # Errors
    /// As [`Plan::free`].
    pub fn by_points(&mut self, knots: &[Vec3]) -> Result<(), AnatomyError> {
        let (side, kerf) = (self.plan.side, self.plan.kerf);
        let plan = Plan::free(side, kerf, knots, FREE_DEPTH, &self.surface)?;
        self.set(plan);
        Ok(())
    }

    /// The same line on the other side; says how far the farthest point was from the bone there \[mm\].
    pub fn mirror(&mut self) -> f64 {
        let (plan, farthest) = self.plan.mirrored(&self.frame, &self.surface);
        self.is_drawn = false;
        self.set(plan);
        farthest
    }

    /// Brings a point of `from` to where the bone is met along a line of sight; its neighbours come along.
    pub fn drag(&mut self, from: &Plan, index: usize, [eye, sight]: [Vec3; 2]) {
        if let Some(to) = self.on_bone([eye, sight]) {
            let mut plan = from.clone();
            plan.drag(index, &to, &self.surface);
            self.set(plan);
        }
    }

    /// Changes the depth about a point.
    pub fn set_depth(&mut self, index: usize, depth: f64) {
        let mut plan = self.plan.clone();
        plan.set_depth(index, depth);
        self.set(plan);
    }

    /// Where the bone is met along a line of sight.
    pub fn on_bone(&self, [eye, sight]: [Vec3; 2]) -> Option<Vec3> {
        cast(&self.surface, &eye, &sight)
    }

    /// The bone's middle along a line of sight.
    pub fn in_bone(&self, [eye, sight]: [Vec3; 2]) -> Option<Vec3> {
        middle_of_sight(&self.surface, &eye, &sight)
    }

    /// A canal drawn through points in the bone, of the mean width; it counts as constructed.
    ///
    /// # Errors
    /// For fewer than two points.
    pub fn draw_canal(&mut self, points: &[Vec3]) -> Result<()> {
        ensure!(
            points.len() >= 2,
            "a canal needs two points or more, from the mandibular to the mental foramen"
        );
        let side = self.plan.side;
        self.canals.retain(|c| c.side != side);
        self.canals.push(Canal {
            side,
            line: points.to_vec(),
            radius: 0.5 * MEAN_DIAMETER,
            is_constructed: true,
        });
        self.is_drawn = true;
        self.look();
        Ok(())
    }

    /// Writes the line (`STEM.osteotomy.json`), a canal that was drawn (`STEM.canal.json`) and the scenario that uses them
    /// (`path`); each appears by rename, the scenario last. An earlier plan of the same name is replaced, nothing else.
    ///
    /// # Errors
    /// Where the line is one that a scenario refuses, `path` is no scenario's, or nothing can be written.
    pub fn save(&self, scenario: &Scenario, path: &Path) -> Result<PathBuf> {
        let line = self.plan.osteotomy(&self.surface)?;
        let path = std::path::absolute(path)?;
        ensure!(
            path.extension().is_some_and(|e| e == "toml"),
            "{}: this is no scenario's name; give one that ends in .toml",
            path.display()
        );
        let beside = |what: &str| path.with_extension(format!("{what}.json"));
        let line_file = beside("osteotomy");
        ensure!(
            !path.exists() || line_file.exists(),
            "{}: there is a scenario of this name that no planning has made; give another name",
            path.display()
        );
        let mut planned = scenario.clone();
        planned.osteotomy = scenario::Osteotomy {
            side: match self.plan.side {
                Side::Right => scenario::Side::Right,
                Side::Left => scenario::Side::Left,
            },
            kerf: self.plan.kerf,
            points: None,
            file: Some(line_file.clone()),
            technique: None,
        };
        if let Some(stem) = path.file_stem() {
            planned.name = stem.to_string_lossy().into_owned();
        }
        let other_side = planned.osteotomy.side != scenario.osteotomy.side;
        if other_side && planned.patient.canal.is_some() {
            // That file is the other side's.
            planned.patient.canal = None;
        }
        if let (true, Some(canal)) = (self.is_drawn, self.canal()) {
            let file = beside("canal");
            write(&file, &serde_json::to_string_pretty(&canal.to_file())?)?;
            planned.patient.canal = Some(file);
        }
        write(&line_file, &serde_json::to_string_pretty(&line.to_file())?)?;
        let tree = toml::Value::try_from(&planned).context("the scenario")?;
        write(&path, &toml::to_string(&tree)?)?;
        Ok(path)
    }
}

fn write(path: &Path, text: &str) -> Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    std::fs::write(&partial, text)
        .and_then(|()| std::fs::rename(&partial, path))
        .with_context(|| path.display().to_string())
}

/// Eye and unit direction through a point of the picture given in half heights from its middle, right and up.
pub fn sight(camera: &Camera, [x, y]: [f64; 2]) -> [Vec3; 2] {
    let v = |a: [f32; 3]| Vec3::from(a.map(f64::from));
    let [right, up, forward] = camera.axes.map(v);
    let (shift, tangent) = (f64::from(camera.shift), f64::from(camera.tangent));
    let through = forward + right * ((x - shift) * tangent) + up * (y * tangent);
    [v(camera.eye), through.normalize()]
}

/// Where a place is in the picture, in half heights from its middle, right and up; `None` behind the eye.
pub fn seen(camera: &Camera, p: &Vec3) -> Option<[f64; 2]> {
    let v = |a: [f32; 3]| Vec3::from(a.map(f64::from));
    let d = p - v(camera.eye);
    let [x, y, z] = camera.axes.map(|a| v(a).dot(&d));
    let scale = z * f64::from(camera.tangent);
    (z > 1.0).then(|| [x / scale + f64::from(camera.shift), y / scale])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine;
    use crate::scenario::{BSSO_RIGHT, Source, load};
    use osteotome_anatomy::PartKind;

    fn prepared() -> (Prepared, Scenario) {
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        let sets = ["mesh.nodes=300", "mesh.shell_points=2000"].map(|s| s.parse().unwrap());
        let scenario = load(&source, &sets, Path::new("/")).unwrap();
        (
            engine::prepare(&scenario, &mut |_, _| {}).unwrap(),
            scenario,
        )
    }

    #[test]
    fn what_is_seen_at_a_place_is_met_there() {
        let camera = Camera::look_at([-200.0, -80.0, 40.0], [0.0; 3], [0.0, 0.0, 1.0], 26.0);
        for p in [Vec3::new(3.0, -20.0, 11.0), Vec3::new(-40.0, 9.0, -30.0)] {
            let [eye, sight] = sight(&camera, seen(&camera, &p).unwrap());
            let off = (p - eye).cross(&sight).norm();
            assert!(off < 1e-3, "{off}");
        }
        let behind = Vec3::new(-300.0, -120.0, 60.0);
        assert!(seen(&camera, &behind).is_none());
    }

    /// A plan is changed in every way, saved, and is the same when the scenario is read and prepared again.
    #[test]
    fn a_saved_plan_is_the_line_of_the_scenario_that_was_saved_with_it() {
        let (prepared, scenario) = prepared();
        let mut planning = Planning::new(&prepared, &scenario);
        assert!(
            planning.review().faults.is_empty(),
            "{:?}",
            planning.review()
        );
        planning.by_technique(Technique::Obwegeser).unwrap();
        planning.mirror();
        let from = planning.plan().clone();
        let of_buccal = |p: &osteotome_anatomy::osteotomy::PlanPoint| p.part == PartKind::Buccal;
        let chosen = from.points.iter().position(of_buccal).unwrap() + 6;
        let at = from.points[chosen].point.at;
        let sight = [at + Vec3::new(60.0, 0.0, 1.0), -Vec3::x()];
        planning.drag(&from, chosen, sight);
        assert!((planning.plan().points[chosen].point.at - at).norm() > 0.2);
        planning.set_depth(chosen, 3.0);
        planning.set_kerf(0.6);
        let middle = planning.in_bone(sight).unwrap();
        planning.draw_canal(&[middle]).unwrap_err();
        planning
            .draw_canal(&[middle, middle + Vec3::new(0.0, -9.0, -3.0)])
            .unwrap();
        assert_eq!(planning.review().canal_is_constructed, Some(true));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("planned.toml");
        planning.save(&scenario, &path).unwrap();
        planning.save(&scenario, &path).unwrap();
        let again = load(&Source::File(path.clone()), &[], Path::new("/")).unwrap();
        assert_eq!(again.name, "planned");
        let again = engine::prepare(&again, &mut |_, _| {}).unwrap().patient;
        let plan = Plan::of(&again.osteotomy);
        assert_eq!((plan.side, plan.kerf), (Side::Left, 0.6));
        for (a, b) in plan.points.iter().zip(&planning.plan().points) {
            assert!((a.point.at - b.point.at).norm() < 1e-9 && a.part == b.part);
            assert!((a.point.depth - b.point.depth).abs() < 1e-9);
        }
        assert_eq!(again.canals.len(), 1);
        let left = std::fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(left, 3, "nothing half written");
        let refused = |path: &Path| planning.save(&scenario, path).unwrap_err().to_string();
        assert!(refused(&folder.path().join("plan.json")).contains("ends in .toml"));
        let foreign = folder.path().join("mine.toml");
        std::fs::write(&foreign, "").unwrap();
        assert!(refused(&foreign).contains("no planning has made"));
    }
}
