//! Contact of chisels with a block of bone: forces are the energy's gradient, act both ways, and stay in the friction cone.
mod support;

use osteotome_mechanics::contact::{
    Anchors, Contact, ContactLaw, ContactScene, NearPoints, PointOrigin, PointShell, Response,
    ShellPoint, ShellPoints, append_point_forces, penetrations, penetrations_in, respond,
    respond_pair,
};
use osteotome_mechanics::geometry::{Pose, TetLocator, Vec3};
use osteotome_mechanics::tool::ToolModel;
use support::{Block, aside, downward, model, moved, noise};

fn contacts(model: &ToolModel, block: &Block, pose: &Pose) -> Vec<Contact> {
    let shape = &model.tools[0].shape;
    let mut near = NearPoints::with_capacity(16_384);
    near.find(shape, pose, &block.scene());
    let mut found = Vec::with_capacity(16_384);
    penetrations(shape, pose, &near, &mut found);
    assert_eq!(near.n_dropped(), 0);
    found
}

fn response(model: &ToolModel, block: &Block, pose: &Pose) -> Response {
    let mut found = contacts(model, block, pose);
    respond(&mut found, &model.law, &Anchors::with_capacity(0), pose)
}

fn random_poses(n: u64) -> impl Iterator<Item = Pose> {
    (0..n).map(|seed| {
        let mut next = noise(seed);
        let turn = Vec3::new(next(), next(), next());
        let at = Vec3::new(15.0 * next(), 10.0 * next(), -1.0 - 3.0 * next().abs());
        downward(at, 0.8 * turn)
    })
}

#[test]
fn the_query_finds_what_brute_force_finds() {
    let block = Block::new(6, |p| {
        p + Vec3::new(0.03 * p.z, -0.02 * p.x, 0.01 * p.y * p.x)
    });
    let model = model(0.0);
    let mut total = 0;
    for pose in random_poses(60) {
        let found = contacts(&model, &block, &pose);
        assert!(found.windows(2).all(|w| w[0].place < w[1].place));
        let ids: Vec<u32> = {
            let mut ids: Vec<u32> = found.iter().map(|c| c.id).collect();
            ids.sort_unstable();
            ids
        };
        total += ids.len();
        for i in 0..block.points.len() {
            let q = pose.inverse_transform_point(&block.deformed_point(i).into());
            let q32 = [0, 1, 2].map(|k| q[k] as f32);
            let sample = model.tools[0].shape.field.look_up(q32);
            let distance = sample.map_or(1.0, |s| s.distance);
            // Points within rounding of the surface may fall on either side.
            if distance.abs() > 1e-4 {
                let listed = ids.binary_search(&(i as u32)).is_ok();
                assert_eq!(listed, distance < 0.0, "point {i} at distance {distance}");
            }
        }
    }
    assert!(
        total > 1000,
        "only {total} contacts: the poses miss the block"
    );
}

/// Differences over 1 um and 0.05 mrad to both sides. A point that changes grid cell on the way changes its gradient, by as
/// much as a turn about on the blade's middle plane: the wrench must lie between the slopes on both sides, within 0.5 % of the
/// largest component for what f32 loses.
#[test]
fn the_tools_wrench_is_minus_the_gradient_of_the_energy() {
    let block = Block::still(8);
    let model = model(0.0);
    for pose in random_poses(40) {
        let here = response(&model, &block, &pose);
        let wrench = here.normal.to_vector();
        assert!(here.energy > 0.0);
        assert_eq!(here.friction.force, Vec3::zeros());
        for k in 0..6 {
            let h = if k < 3 { 1e-3 } else { 5e-5 };
            let energy = |h: f64| {
                let mut motion = [0.0; 6];
                motion[k] = h;
                response(&model, &block, &moved(&pose, &motion)).energy
            };
            let ahead = (here.energy - energy(h)) / h;
            let behind = (energy(-h) - here.energy) / h;
            let size = if k < 3 {
                here.normal.force.norm()
            } else {
                here.normal.torque.norm()
            };
            let tolerance = 5e-3 * (size + 1.0);
            assert!(
                wrench[k] > ahead.min(behind) - tolerance
                    && wrench[k] < ahead.max(behind) + tolerance,
                "component {k}: slopes {ahead} and {behind} against {}",
                wrench[k]
            );
        }
    }
}

/// The same from the bone's side: moving one cell's virtual node.
#[test]
fn the_bones_forces_are_minus_the_gradient_of_the_energy() {
    let mut block = Block::still(8);
    let model = model(0.0);
    let pose = downward(Vec3::new(1.3, 0.7, -1.5), Vec3::new(0.2, -0.1, 0.4));
    let found = contacts(&model, &block, &pose);
    let forces = forces(&found, &model.law, &block, &pose);
    let cell = forces[forces.len() / 2].cell;
    let h = 2e-3f32;
    for node in 0..4 {
        for axis in 0..3 {
            let expected: f64 = forces
                .iter()
                .filter(|f| f.cell == cell)
                .map(|f| f.force[axis] * f64::from(f.weights[node]))
                .sum();
            let mut energy = |h: f32| {
                let old = block.deformation.clone();
                block.deformation[cell as usize][(axis, node)] += h;
                block.volumes.update(&block.shell, &block.deformation);
                let energy = response(&model, &block, &pose).energy;
                block.deformation = old;
                energy
            };
            let slope = -(energy(h) - energy(-h)) / f64::from(2.0 * h);
            assert!(
                (slope - expected).abs() < 0.02 * (expected.abs() + 1.0),
                "{slope} {expected}"
            );
        }
    }
}

fn forces(
    found: &[Contact],
    law: &ContactLaw,
    block: &Block,
    pose: &Pose,
) -> Vec<osteotome_mechanics::contact::PointForce> {
    let mut forces = Vec::with_capacity(found.len());
    append_point_forces(found, law, &block.scene(), pose, &mut forces);
    forces
}

#[test]
fn bone_and_tool_push_equally_hard() {
    let block = Block::still(8);
    let model = model(0.3);
    for pose in random_poses(30) {
        let mut anchors = Anchors::with_capacity(block.points.len());
        anchors.commit(&contacts(&model, &block, &pose));
        let slid = moved(&pose, &[0.02, -0.01, -0.03, 0.001, 0.0, 0.002]);
        let mut found = contacts(&model, &block, &slid);
        let on_tool = respond(&mut found, &model.law, &anchors, &slid);
        assert!(on_tool.friction.force.norm() > 0.0);
        let (mut force, mut moment) = (Vec3::zeros(), Vec3::zeros());
        for f in forces(&found, &model.law, &block, &slid) {
            force += f.force;
            moment += (f.point - slid.translation.vector).cross(&f.force);
        }
        let total = on_tool.total();
        assert!((force + total.force).norm() < 1e-5 * total.force.norm());
        assert!((moment + total.torque).norm() < 1e-5 * (total.torque.norm() + total.force.norm()));
    }
}

#[test]
fn friction_never_exceeds_mu_times_the_normal_force() {
    let block = Block::still(6);
    for (seed, mu) in [(1, 0.0), (2, 0.1), (3, 0.3), (4, 1.0)] {
        let model = model(mu);
        let mut anchors = Anchors::with_capacity(block.points.len());
        let mut next = noise(seed);
        let mut pose = downward(Vec3::new(2.0, 1.0, -2.0), Vec3::new(0.1, 0.2, 0.3));
        let (mut sticking, mut sliding) = (0, 0);
        for _ in 0..200 {
            let step = [0; 6].map(|_| next());
            let motion = [0.05, 0.05, 0.05, 3e-3, 3e-3, 3e-3];
            pose = moved(&pose, &[0, 1, 2, 3, 4, 5].map(|k| motion[k] * step[k]));
            let mut found = contacts(&model, &block, &pose);
            respond(&mut found, &model.law, &anchors, &pose);
            for c in &found {
                let length = |v: [f32; 3]| f64::from(v.iter().map(|c| c * c).sum::<f32>()).sqrt();
                let normal = 500.0 * f64::from(c.area * c.depth) * length(c.gradient);
                let friction = length(c.friction);
                assert!(friction <= mu * normal * (1.0 + 1e-5) + 1e-12);
                let along: f32 = (0..3).map(|k| c.friction[k] * c.gradient[k]).sum();
                assert!(f64::from(along).abs() <= 1e-5 * friction + 1e-12);
                if friction > 0.0 {
                    let slides = friction > 0.999 * mu * normal;
                    *(if slides { &mut sliding } else { &mut sticking }) += 1;
                }
            }
            anchors.commit(&found);
        }
        if mu > 0.0 {
            assert!(
                sticking > 100 && sliding > 100,
                "{sticking} {sliding}: not both regimes"
            );
        }
    }
}

/// A tool that has slid far pulls no more than when it began to slide: the anchors came along.
#[test]
fn anchors_are_dragged_and_let_go() {
    let block = Block::still(8);
    let model = model(0.3);
    let mut anchors = Anchors::with_capacity(block.points.len());
    // The flat side of the blade lies on the block, 0.1 mm deep; it slides along its width.
    let lying = |x: f64| {
        let turn = Vec3::new(0.5 * std::f64::consts::PI, 0.0, 0.0);
        downward(Vec3::new(x, 3.0, 1.4), turn)
    };
    let mut last = 0.0;
    for i in 0..40 {
        let pose = lying(0.025 * f64::from(i));
        let mut found = contacts(&model, &block, &pose);
        let r = respond(&mut found, &model.law, &anchors, &pose);
        anchors.commit(&found);
        last = r.friction.force.x / r.normal.force.z;
    }
    // Opposite to the motion, at its limit except for points that have just come in at the leading edge.
    assert!(last < -0.2 && last > -0.303, "{last}");
    anchors.commit(&[]);
    assert!((0..block.points.len() as u32).all(|id| anchors.get(id).is_none()));
}

/// For a flat side on a flat block the field is linear, so the stiffness is the derivative itself.
#[test]
fn the_stiffness_is_minus_the_derivative_of_the_wrench() {
    let block = Block::still(8);
    let model = model(0.3);
    let turn = Vec3::new(0.5 * std::f64::consts::PI + 0.002, 0.003, 0.1);
    let first = downward(Vec3::new(0.3, 9.0, 1.35), turn);
    let pose = moved(&first, &[0.004, 0.003, -0.001, 0.0, 0.0, 0.0]);
    let mut anchors = Anchors::with_capacity(block.points.len());
    anchors.commit(&contacts(&model, &block, &first));
    let at = |pose: &Pose| {
        let mut found = contacts(&model, &block, pose);
        respond(&mut found, &model.law, &anchors, pose)
    };
    let stiffness = at(&pose).stiffness;
    assert!((stiffness - stiffness.transpose()).norm() < 1e-9 * stiffness.norm());
    // Scaled by 20 mm, so that forces and torques compare.
    let scale = |k: usize| if k < 3 { 1.0 } else { 1.0 / 20.0 };
    for k in 0..6 {
        let h = 1e-4 * scale(k);
        let wrench = |h: f64| {
            let mut motion = [0.0; 6];
            motion[k] = h;
            at(&moved(&pose, &motion)).total().to_vector()
        };
        let column = -(wrench(h) - wrench(-h)) / (2.0 * h);
        for i in 0..6 {
            let error = (column[i] - stiffness[(i, k)]) * scale(i) * scale(k);
            assert!(error.abs() < 0.03 * stiffness[(2, 2)], "{i} {k}: {error}");
        }
    }
}

#[test]
fn chisels_push_each_other_equally_hard() {
    let model = model(0.3);
    let shapes = [&model.tools[0].shape, &model.tools[1].shape];
    let mut touched = 0;
    for seed in 0..40 {
        let mut next = noise(seed);
        let mut v = |s: f64| Vec3::new(next(), next(), next()) * s;
        let poses = [downward(v(3.0), v(0.5)), downward(v(3.0), v(0.5))];
        let r = respond_pair(shapes, &poses, &model.law);
        let [a, b] = r.wrenches;
        let lever = poses[1].translation.vector - poses[0].translation.vector;
        let size = a.force.norm();
        assert!((a.force + b.force).norm() <= 1e-9 * size);
        let moment = a.torque + b.torque + lever.cross(&b.force);
        assert!(moment.norm() <= 1e-8 * (a.torque.norm() + b.torque.norm() + size));
        touched += usize::from(r.n_contacts > 0);
        assert_eq!(r.n_contacts > 0, r.energy > 0.0);
    }
    assert!(touched > 20);
    let apart = respond_pair(
        shapes,
        &[downward(Vec3::zeros(), Vec3::zeros()), aside()],
        &model.law,
    );
    assert_eq!(apart.n_contacts, 0);
}

#[test]
fn the_pairs_wrenches_are_minus_the_gradient_of_the_energy() {
    let model = model(0.0);
    let shapes = [&model.tools[0].shape, &model.tools[1].shape];
    let poses = [
        downward(Vec3::zeros(), Vec3::zeros()),
        downward(Vec3::new(1.2, 2.1, 0.7), Vec3::new(0.05, 0.02, 0.3)),
    ];
    let here = respond_pair(shapes, &poses, &model.law);
    assert!(here.n_contacts > 0);
    for k in 0..12 {
        let h = if k % 6 < 3 { 1e-3 } else { 2e-5 };
        let energy = |h: f64| {
            let mut motion = [0.0; 6];
            motion[k % 6] = h;
            let mut at = poses;
            at[k / 6] = moved(&poses[k / 6], &motion);
            respond_pair(shapes, &at, &model.law).energy
        };
        let slope = -(energy(h) - energy(-h)) / (2.0 * h);
        let w = here.wrenches[k / 6];
        let size = if k % 6 < 3 {
            w.force.norm()
        } else {
            w.torque.norm()
        };
        assert!(
            (slope - w.to_vector()[k % 6]).abs() < 1e-2 * (size + 1.0),
            "{k}"
        );
    }
}

/// A blade that has run ahead of the crack, 0.05 mm off its middle: both faces of the new crack must be pushed apart, each
/// into its own bone, though half of the points lie beyond the blade's middle plane. As surface points they would not be.
#[test]
fn a_blade_ahead_of_the_crack_pushes_both_walls_apart() {
    let mut block = Block::still(2);
    let mesh = &block.mesh.clone();
    let locator = TetLocator::new(mesh);
    let wall = |side: f64, known: bool| {
        let locator = &locator;
        (0..20).flat_map(move |i| {
            (0..4).map(move |j| {
                let position = Vec3::new(-3.8 + 0.4 * f64::from(i), 0.0, -0.2 - 0.2 * f64::from(j));
                let (tet, weights) = locator.find(mesh, &position).unwrap();
                // `side` is where the wall's own bone lies; the normal points out of it.
                let normal = Vec3::y() * -side;
                ShellPoint {
                    position,
                    tet,
                    weights: weights.map(|w| w as f32),
                    area: 0.08,
                    origin: if known {
                        PointOrigin::Wall { normal }
                    } else {
                        PointOrigin::Surface
                    },
                }
            })
        })
    };
    let model = model(0.0);
    let pose = downward(Vec3::new(0.0, 0.05, -1.0), Vec3::zeros());
    let mut push = |side: f64, known: bool| {
        let points: Vec<_> = wall(side, known).collect();
        let cells: Vec<u32> = points.iter().map(|p| p.tet).collect();
        let points = ShellPoints::new(points.into());
        block.shell = PointShell::group(&points, &cells, block.mesh.tets().len());
        block.volumes.update(&block.shell, &block.deformation);
        let found = contacts(&model, &block, &pose);
        assert_eq!(found.len(), 80);
        forces(&found, &model.law, &block, &pose)
    };
    for side in [1.0, -1.0] {
        assert!(push(side, true).iter().all(|f| f.force.y * side > 0.0));
    }
    assert!(push(1.0, false).iter().all(|f| f.force.y < 0.0));
}

/// Points found once serve as long as shape and bone stay near where they were: the contacts are those of a search at each step, to the
/// last bit. The blade wanders, twists and tilts, for some time in one state of the bone.
#[test]
fn near_points_are_kept_without_losing_a_contact() {
    let block = Block::still(16);
    let model = model(0.0);
    let mut kept = Kept::default();
    let mut random = noise(11);
    let mut pose = downward(Vec3::new(-6.0, 0.4, -1.0), Vec3::zeros());
    for _ in 0..400 {
        let most = [0.06, 0.06, 0.06, 0.005, 0.005, 0.02];
        let motion = most.map(|most| random() * most);
        let towards = -1.0 - pose.translation.vector.z;
        pose = moved(&pose, &motion);
        pose.translation.vector.z += 0.1 * towards;
        kept.check(&model, &block, &pose);
    }
    assert!(kept.n > 400, "{}: hardly touched", kept.n);
}

/// Contacts of near points that are kept, against those of points found anew.
struct Kept {
    near: NearPoints,
    found: Vec<Contact>,
    /// All contacts so far.
    n: usize,
}

impl Default for Kept {
    fn default() -> Self {
        Self {
            near: NearPoints::with_capacity(16_384),
            found: Vec::with_capacity(16_384),
            n: 0,
        }
    }
}

impl Kept {
    fn check(&mut self, model: &ToolModel, block: &Block, pose: &Pose) {
        let scene = ContactScene {
            state: 7,
            ..block.scene()
        };
        let shape = &model.tools[0].shape;
        self.near.follow(shape, pose, &scene);
        penetrations(shape, pose, &self.near, &mut self.found);
        assert_eq!(self.found, contacts(model, block, pose));
        self.n += self.found.len();
    }
}

/// Likewise of walls at the narrow sides of a blade and before its edge. There the depth behind a wall's own side falls three times as
/// fast as the blade moves, and a wall on the blade's far side is near nothing else of it.
#[test]
fn walls_at_a_blades_ends_are_kept_too() {
    let block = walled(Block::still(16));
    let model = model(0.0);
    let mut random = noise(5);
    let mut n_contacts = 0;
    for start in 0..40 {
        let mut kept = Kept::default();
        let at = Vec3::new(15.0 * random(), 10.0 * random(), -1.0 - random().abs());
        let mut pose = downward(at, Vec3::new(0.0, 0.0, 3.0 * random()));
        // Along the blade's width, or the way that it is driven.
        let axis = if start % 2 == 0 { Vec3::x() } else { Vec3::z() };
        let way = pose.rotation * axis * random().signum();
        for _ in 0..20 {
            pose.translation.vector += way * 0.02;
            kept.check(&model, &block, &pose);
        }
        n_contacts += kept.n;
    }
    assert!(n_contacts > 4000, "{n_contacts}: hardly touched");
}

/// A block whose points are by turns of its surface and of walls.
fn walled(mut block: Block) -> Block {
    let faces = [Vec3::y(), -Vec3::y(), Vec3::new(0.6, 0.8, 0.0)];
    let wall = |k: usize| {
        let point = *block.points.get(k as u32);
        let origin = faces.get(k % 4).map(|n| PointOrigin::Wall { normal: *n });
        ShellPoint {
            origin: origin.unwrap_or(PointOrigin::Surface),
            ..point
        }
    };
    let points: Vec<_> = (0..block.points.len()).map(wall).collect();
    let cells: Vec<u32> = points.iter().map(|p| p.tet).collect();
    let points = ShellPoints::new(points.into());
    block.shell = PointShell::group(&points, &cells, block.mesh.tets().len());
    block
}

/// Four points at a time give what one at a time gives, to the last bit: on the surface, and on walls that look either way.
#[test]
fn four_lanes_are_one_lane_four_times() {
    let block = walled(Block::new(9, |p| {
        p + Vec3::new(0.03 * p.z, -0.02 * p.x, 0.01 * p.y * p.x)
    }));
    let model = model(0.0);
    let shape = &model.tools[0].shape;
    let mut near = [0; 2].map(|_| NearPoints::with_capacity(16_384));
    let mut found = [0; 2].map(|_| Vec::with_capacity(16_384));
    let mut n_contacts = 0;
    for pose in random_poses(60) {
        let scene = block.scene();
        near[0].find_in::<f32>(shape, &pose, &scene);
        near[1].find(shape, &pose, &scene);
        assert_eq!(near[0].len(), near[1].len());
        penetrations_in::<f32>(shape, &pose, &near[0], &mut found[0]);
        penetrations(shape, &pose, &near[1], &mut found[1]);
        assert_eq!(found[0], found[1]);
        n_contacts += found[0].len();
    }
    assert!(n_contacts > 1000, "{n_contacts}: hardly touched");
}

/// Where there is no room for all, the shallow points are left out and counted.
#[test]
fn the_deepest_points_are_never_dropped() {
    let block = Block::still(16);
    let model = model(0.0);
    let shape = &model.tools[0].shape;
    let pose = downward(Vec3::new(-6.0, 0.4, -1.2), Vec3::new(0.2, 0.0, 0.1));
    let all = contacts(&model, &block, &pose);
    let room = all.len() / 3;
    let mut near = NearPoints::with_capacity(room);
    near.find(shape, &pose, &block.scene());
    let mut found = Vec::with_capacity(room);
    penetrations(shape, &pose, &near, &mut found);
    assert!(near.n_dropped() > 0 && found.len() > room / 4);
    let shallowest = found.iter().fold(f32::INFINITY, |d, c| d.min(c.depth));
    let deeper = all.iter().filter(|c| c.depth > shallowest + 0.1);
    for contact in deeper {
        assert!(found.contains(contact), "lost one {} deep", contact.depth);
    }
}
