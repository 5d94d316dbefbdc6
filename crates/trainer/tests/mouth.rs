//! Access through the mouth, as the shipped scenarios have it: where the built-in surgeon works, both blades lie free of lips, retractor, upper
//! jaw and teeth; led astray, they are stopped by them. With `OSTEOTOME_LONG=1` on other jaws, too, and both whole splits.
use osteotome::engine::{Prepared, prepare, tools_among};
use osteotome::scenario::{self, Override, Scenario, Source};
use osteotome::surgeon::BuiltInSurgeon;
use osteotome_mechanics::contact::{PairResponse, add_static};
use osteotome_mechanics::geometry::{MeshDistance, Pose, Vec3};
use osteotome_mechanics::tool::ToolModel;
use std::path::{Path, PathBuf};

fn is_long() -> bool {
    std::env::var_os("OSTEOTOME_LONG").is_some()
}

fn file(side: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios");
    folder.join(format!("bsso_{side}_mouth.toml"))
}

struct Scene {
    prepared: Prepared,
    tools: ToolModel,
    /// Of both blades, edge on the bone's surface.
    poses: [Pose; 2],
    /// Roles, and true distances: of soft tissue the tools' field is another.
    around: Vec<(String, MeshDistance)>,
    /// Sign of x of the operated side.
    out: f64,
}

impl Scene {
    fn new(side: &str, change: &str) -> Self {
        let sets = [change, "mesh.shell_points=2000"].map(|s| s.parse::<Override>().unwrap());
        let s: Scenario = scenario::load(&Source::File(file(side)), &sets, Path::new(".")).unwrap();
        let prepared = prepare(&s, &mut |_, _| {}).unwrap();
        let surgeon = BuiltInSurgeon::new(&s, prepared.line.clone());
        let down = Pose::translation(0.0, 0.0, s.surgeon.approach_distance);
        let around = prepared.surroundings.iter();
        Self {
            tools: tools_among(&prepared, &s).unwrap(),
            poses: surgeon.targets().map(|p| p * down),
            around: around
                .map(|a| (a.role.clone(), MeshDistance::new(a.mesh.clone())))
                .collect(),
            out: if side == "left" { 1.0 } else { -1.0 },
            prepared,
        }
    }

    /// Least distance of a blade from what stands around, and from what.
    fn nearest(&self, hand: usize, pose: &Pose) -> (f64, &str) {
        let samples = &self.tools.tools[hand].shape.samples;
        let from = |d: &MeshDistance| {
            let all = samples.iter().map(|s| {
                let p = pose * nalgebra::Point3::from(s.position);
                d.signed_within(&p.coords)
            });
            all.fold(f64::INFINITY, f64::min)
        };
        let all = self.around.iter().map(|(role, d)| (from(d), role.as_str()));
        all.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
    }

    /// Force of what stands around on a blade \[N\].
    fn force(&self, hand: usize, pose: &Pose) -> f64 {
        let mut poses = [Pose::translation(1e4, 0.0, 0.0); 2];
        poses[hand] = *pose;
        let mut response = PairResponse::NONE;
        let shapes = [0, 1].map(|i| &self.tools.tools[i].shape);
        let around = &self.tools.surroundings;
        add_static(&mut response, shapes, &poses, around, &self.tools.law);
        response.wrenches[hand].force.norm()
    }
}

trait Signed {
    fn signed_within(&self, p: &Vec3) -> f64;
}

impl Signed for MeshDistance {
    /// The distance, or where that is plain something less than it but far.
    fn signed_within(&self, p: &Vec3) -> f64 {
        const FAR: f64 = 8.0; // mm
        if self.mesh().bounds().grown(FAR).contains(p) {
            self.signed(p)
        } else {
            FAR
        }
    }
}

fn check(side: &str, change: &str) {
    let scene = Scene::new(side, change);
    let name = format!("{side} {change}");
    assert_eq!(scene.prepared.surroundings.len(), 4, "{name}");
    assert_eq!(
        scene.tools.surroundings.len(),
        4,
        "{name}: all can be touched"
    );
    let mut least = (f64::INFINITY, String::new());
    for hand in 0..2 {
        for depth in [-10.0, 0.0, 8.0, 16.0] {
            for twist in [-0.6, 0.0, 0.6] {
                let turn = nalgebra::UnitQuaternion::from_scaled_axis(Vec3::z() * twist);
                let at = Pose::from_parts(Vec3::new(0.0, 0.0, depth).into(), turn);
                let (d, role) = scene.nearest(hand, &(scene.poses[hand] * at));
                if d < least.0 {
                    least = (d, format!("hand {hand} at {depth} mm from {role}"));
                }
            }
        }
        // Astray: to the cheek, to the upper jaw and to the chin, never in the way of bone.
        for (whither, direction) in [
            ("out", Vec3::x() * scene.out),
            ("up", Vec3::z()),
            ("down", -Vec3::z()),
        ] {
            let moved = |far: f64| Pose::from(Vec3::from(direction * far)) * scene.poses[hand];
            let first = (0..60)
                .map(|k| 0.5 * f64::from(k))
                .find(|far| scene.nearest(hand, &moved(*far)).0 < 0.0);
            let first =
                first.unwrap_or_else(|| panic!("{name}: hand {hand} meets nothing {whither}"));
            // Soft tissue gives way at first; a retractor is thin.
            let within = (1..=8).map(|more| scene.force(hand, &moved(first + f64::from(more))));
            let most = within.fold(0.0, f64::max);
            assert!(
                first > 1.5 && most > 10.0,
                "{name}: hand {hand} {whither}: {first} mm, {most} N"
            );
        }
    }
    assert!(least.0 > 1.5, "{name}: {} mm, {}", least.0, least.1);
}

#[test]
fn blades_lie_free_in_the_mouth_and_are_stopped_when_led_astray() {
    for side in ["right", "left"] {
        check(side, "patient.parametric.scale=1.0");
        if is_long() {
            for change in [
                "scale=0.8",
                "scale=1.2",
                "chin_deviation=6.0",
                "gonial_angle=136.0",
                "ramus_thickness=6.0",
                "mouth_opening=35.0",
            ] {
                check(side, &format!("patient.parametric.{change}"));
            }
        }
    }
}

/// The built-in surgeon completes the split on both sides, and touches nothing around the jaw.
#[test]
fn the_jaw_is_split_through_the_mouth_on_both_sides() {
    if !is_long() {
        return;
    }
    let base = tempfile::tempdir().unwrap();
    for side in ["right", "left"] {
        let out = base.path().join(side);
        let run = std::process::Command::new(env!("CARGO_BIN_EXE_osteotome"))
            .args(["run", "--json", "--max-time", "15", "--out"])
            .args([&out, &file(side)])
            .output()
            .unwrap();
        assert!(
            run.status.success(),
            "{}",
            String::from_utf8_lossy(&run.stderr)
        );
        let metrics: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
        assert_eq!(
            metrics["split"]["complete"], true,
            "{side}: {}",
            metrics["split"]
        );
        let around = metrics["debrief"]["context"].as_array().unwrap();
        assert_eq!(around.len(), 4);
        for s in around {
            let seconds = s["seconds"].as_f64().unwrap();
            assert!(seconds < 0.2, "{side}: {s}");
        }
    }
}
