//! What a haptic step and its contact query cost, with both chisels in the kerf of a splitting mandible.
//!
//! The built-in surgeon splits in lockstep until both chisels press on the walls; from there the program's own haptic step is
//! timed with hands that tremble, and the contact query against the same query point by point in the same near cells (no
//! blocks, no vector registers) and over all points of the bone. All three must find the same contacts.
//! Run with `cargo bench -p osteotome --bench haptic`; `OSTEOTOME_MANDIBLE=DIR` takes mandible.stl and osteotomy_right.json
//! from a folder instead of the parametric jaw. Arguments of digits: nodes, then points.
#![allow(clippy::print_stdout)]
use osteotome::engine::{connect, prepare, tool_model};
use osteotome::input::Input;
use osteotome::loops::{HapticPart, Sink, lockstep};
use osteotome::scenario::{BSSO_RIGHT, Scenario, Source, load};
use osteotome::session::{GrowthSample, HapticSample, Loop, MainSample, Pace, StepTime};
use osteotome_mechanics::contact::{
    BoundingVolumes, Contact, ContactScene, NearPoints, RigidShape, penetrations,
};
use osteotome_mechanics::geometry::{Aabb, Pose, Vec3};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

/// Keeps the last haptic sample.
#[derive(Default)]
struct Last(Option<HapticSample>);

impl Sink for Last {
    fn haptic(&mut self, sample: &HapticSample) -> anyhow::Result<()> {
        self.0 = Some(*sample);
        Ok(())
    }
    fn main(&mut self, _: &MainSample) -> anyhow::Result<()> {
        Ok(())
    }
    fn growth(&mut self, _: GrowthSample) -> anyhow::Result<()> {
        Ok(())
    }
    fn timing(&mut self, _: &StepTime, _: bool) -> anyhow::Result<()> {
        Ok(())
    }
    fn event(&mut self, _: f64, _: &str) -> anyhow::Result<()> {
        Ok(())
    }
    fn pace(&mut self, _: Loop, _: Pace) {}
}

fn scenario(nodes: usize, points: usize) -> Scenario {
    let mut sets = vec![
        format!("mesh.nodes={nodes}"),
        format!("mesh.shell_points={points}"),
        "max_time=2.6".into(),
    ];
    if let Ok(folder) = std::env::var("OSTEOTOME_MANDIBLE") {
        sets.push(format!("patient.surface='{folder}/mandible.stl'"));
        sets.push(format!("osteotomy.file='{folder}/osteotomy_right.json'"));
    }
    let source = Source::Text {
        name: "bench".into(),
        text: BSSO_RIGHT.into(),
    };
    let sets: Vec<_> = sets.iter().map(|s| s.parse().unwrap()).collect();
    load(&source, &sets, Path::new("/")).unwrap()
}

struct Times(Vec<f64>);

impl Times {
    fn of(n: usize, mut call: impl FnMut(usize)) -> Self {
        let time = |k| {
            let begin = Instant::now();
            call(k);
            begin.elapsed().as_secs_f64() * 1e3
        };
        let mut times: Vec<f64> = (0..n).map(time).collect();
        times.sort_by(f64::total_cmp);
        Self(times)
    }

    fn at(&self, share: f64) -> f64 {
        self.0[((self.0.len() - 1) as f64 * share) as usize]
    }

    fn print(&self, name: &str) {
        let mean = self.0.iter().sum::<f64>() / self.0.len() as f64;
        let [p50, p99, max] = [0.5, 0.99, 1.0].map(|s| self.at(s));
        println!("{name:44} mean {mean:.4}  median {p50:.4}  p99 {p99:.4}  max {max:.4} ms");
    }
}

/// Hands that tremble by a tenth of a millimetre at 9 Hz.
fn trembling(devices: &[Pose; 2], step: usize) -> [Pose; 2] {
    let phase = step as f64 * 1e-3 * 9.0 * std::f64::consts::TAU;
    let mut moved = *devices;
    for (t, pose) in moved.iter_mut().enumerate() {
        let way = Vec3::new(
            phase.sin(),
            (phase + 1.0).cos(),
            (1.3 * phase + t as f64).sin(),
        );
        pose.translation.vector += way * 0.1;
    }
    moved
}

/// The bone's points inside a shape among those of some cells, one by one: how many, and their depths' sum.
fn one_by_one(
    shape: &RigidShape,
    pose: &Pose,
    scene: &ContactScene,
    cells: impl Iterator<Item = u32>,
) -> (usize, f64) {
    let into = pose.inverse();
    let mut found = (0, 0.0);
    for cell in cells {
        let corners = &scene.deformation[cell as usize];
        for k in scene.shell.places(cell as usize..cell as usize + 1) {
            let (Some(weights), Some(normal)) = (scene.shell.weights(k), scene.shell.normal(k))
            else {
                continue;
            };
            let mut at = Vec3::zeros();
            for (corner, w) in corners.column_iter().zip(weights) {
                at += corner.map(f64::from) * f64::from(w);
            }
            let local = into.rotation * at + into.translation.vector;
            let wall = (normal != [0.0; 3]).then(|| {
                let n = into.rotation * Vec3::from(normal.map(f64::from));
                <[f32; 3]>::from(n.map(|v| v as f32))
            });
            let local = <[f32; 3]>::from(local.map(|v| v as f32));
            if let Some(sample) = shape.penetration(local, wall.as_ref()) {
                found.0 += 1;
                found.1 -= f64::from(sample.distance);
            }
        }
    }
    found
}

/// The box around a shape in the world.
fn tight_box(shape: &RigidShape, pose: &Pose) -> Aabb {
    let b = &shape.bounds;
    let corner = |k: usize| {
        let pick = |axis: usize| [b.min, b.max][k >> axis & 1][axis];
        pose.rotation * Vec3::new(pick(0), pick(1), pick(2)) + pose.translation.vector
    };
    let corners: Vec<Vec3> = (0..8).map(corner).collect();
    Aabb::around(&corners)
}

fn main() {
    let given: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let nodes = given.first().copied().unwrap_or(5000);
    let points = given.get(1).copied().unwrap_or(104_567);
    let scenario = scenario(nodes, points);
    let prepared = prepare(&scenario, &mut |_, _| {}).unwrap();
    let mut input = Input::built_in(&scenario, prepared.line.clone()).unwrap();
    let start = input.read().map(|r| r.pose);
    input.rewind();
    let engine = connect(&prepared, &scenario, start).unwrap();
    let mut last = Last::default();
    let mut engine = lockstep(engine, input, &scenario, &mut last, &mut |_, _| {}).unwrap();
    let sample = last.0.unwrap();
    let devices = sample.hands.map(|h| h.device_pose);

    let times = Times::of(4000, |k| {
        black_box(engine.haptic.step(&trembling(&devices, k), 1e-3));
    });
    let (bone, state) = (engine.main.bone(), engine.main.state());
    println!(
        "{} nodes, {} tets, {} points; contacts of the hands {:?}",
        bone.body.mesh.nodes().len(),
        bone.body.mesh.tets().len(),
        bone.shell.len(),
        sample.hands.map(|h| h.contacts)
    );
    times.print("haptic step");

    let mut moving = state.clone();
    let mut volumes = BoundingVolumes::new(&bone.shell, &state.deformation);
    Times::of(200, |_| {
        bone.deform(&mut moving);
        volumes.update(&bone.shell, &moving.deformation);
    })
    .print("collision update");

    let scene = ContactScene {
        shell: &bone.shell,
        volumes: &volumes,
        deformation: &state.deformation,
        state: 0,
    };
    let model = tool_model(&scenario).unwrap();
    for (t, hand) in sample.hands.iter().enumerate() {
        let (shape, pose) = (&model.tools[t].shape, &hand.tool_pose);
        let mut near = NearPoints::with_capacity(20_000, 20_000);
        let mut contacts: Vec<Contact> = Vec::with_capacity(20_000);
        let find = Times::of(400, |_| near.find(shape, pose, &scene));
        let ours = Times::of(400, |_| {
            penetrations(shape, pose, &scene, &near, black_box(&mut contacts));
        });
        let mut near_cells = Vec::new();
        volumes.query(&tight_box(shape, pose), |c, _| near_cells.push(c));
        near_cells.sort_unstable();
        near_cells.dedup();
        let near_cells = || near_cells.iter().copied();
        let plain = Times::of(100, |_| {
            black_box(one_by_one(shape, pose, &scene, near_cells()));
        });
        let all_cells = || 0..scene.shell.n_cells() as u32;
        let all = Times::of(20, |_| {
            black_box(one_by_one(shape, pose, &scene, all_cells()));
        });
        let depth: f64 = contacts.iter().map(|c| f64::from(c.depth)).sum();
        for (n, other) in [
            one_by_one(shape, pose, &scene, near_cells()),
            one_by_one(shape, pose, &scene, all_cells()),
        ] {
            assert!(
                n.abs_diff(contacts.len()) <= 1 + contacts.len() / 100,
                "{n} contacts against {}",
                contacts.len()
            );
            assert!(
                (other - depth).abs() <= 1e-2 * depth.max(1.0),
                "depths {other} against {depth}"
            );
        }
        let tested: usize = near_cells()
            .map(|c| scene.shell.places(c as usize..c as usize + 1).len())
            .sum();
        println!(
            "tool {t}: {} cells in its box with {tested} points; {} near points, {} contacts",
            near_cells().count(),
            near.len(),
            contacts.len()
        );
        find.print("  finding the near points");
        ours.print("  query of the near points");
        plain.print("  baseline: point by point in its box");
        all.print("  baseline: point by point over all");
        println!(
            "  ratio of finding and query: {:.1} to point by point, {:.1} to all points",
            plain.at(0.5) / (ours.at(0.5) + find.at(0.5)),
            all.at(0.5) / (ours.at(0.5) + find.at(0.5))
        );
    }
}
