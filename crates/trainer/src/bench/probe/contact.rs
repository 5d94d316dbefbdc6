//! Who touches: the contact query and its update, against looking at every point.
use super::in_ms;
use crate::bench::rows::{Part, Row};
use crate::bench::times::{Pairs, Times};
use anyhow::{Result, ensure};
use nalgebra::Matrix3x4;
use osteotome_mechanics::contact::{
    BoundingVolumes, Contact, ContactScene, NearPoints, PointShell, RigidShape, penetrations_in,
};
use osteotome_mechanics::geometry::{Aabb, Lanes, Pose, SpatialHash, Vec3};
use osteotome_mechanics::step::{Bone, BoneState};
use osteotome_mechanics::tool::ToolModel;
use wide::f32x4;

/// Baselines of the query are tried at every so many haptic steps, those of the update at every so many main steps.
const EVERY: [u64; 2] = [37, 7];
/// As the program's own scratch.
const ROOM: usize = 16_384;

/// Queries of both tools as the haptic loop makes them, and updates as the main loop makes them.
pub struct Contacts {
    near: [NearPoints; 2],
    found: [Vec<Contact>; 2],
    query: Times,
    /// The same, one point at a time.
    plain_near: [NearPoints; 2],
    plain_found: [Vec<Contact>; 2],
    plain: Pairs,
    in_box: Pairs,
    everywhere: Pairs,
    n_queries: u64,
    moved: BoneState,
    volumes: BoundingVolumes,
    update: Times,
    every_point: Pairs,
    n_updates: u64,
}

impl Default for Contacts {
    fn default() -> Self {
        let near = || NearPoints::with_capacity(ROOM);
        Self {
            near: [near(), near()],
            found: [Vec::with_capacity(ROOM), Vec::with_capacity(ROOM)],
            query: Times::default(),
            plain_near: [near(), near()],
            plain_found: [Vec::with_capacity(ROOM), Vec::with_capacity(ROOM)],
            plain: Pairs::new("the same query, one point at a time (no SIMD)"),
            in_box: Pairs::new("the points of all cells that meet the tool's box, one by one"),
            everywhere: Pairs::new("all points of the bone, one by one"),
            n_queries: 0,
            moved: BoneState::default(),
            volumes: BoundingVolumes::default(),
            update: Times::default(),
            every_point: Pairs::new("every point moved, and the volumes hashed anew"),
            n_updates: 0,
        }
    }
}

impl Contacts {
    /// A query of both tools at `poses`; says how long it took \[ms\].
    ///
    /// # Errors
    /// A baseline that finds other contacts.
    pub fn query(
        &mut self,
        model: &ToolModel,
        poses: &[Pose; 2],
        scene: &ContactScene,
    ) -> Result<f64> {
        // Turn about, so that neither always finds the caches filled by the other.
        let plain_first = self.n_queries.is_multiple_of(2);
        let mut plain = plain_first.then(|| self.query_plainly(model, poses, scene));
        let (near, found) = (&mut self.near, &mut self.found);
        let ((), ours) = in_ms(|| query::<f32x4>(model, poses, scene, near, found));
        if !plain_first {
            plain = Some(self.query_plainly(model, poses, scene));
        }
        let plain = plain.unwrap_or_default();
        self.plain.push(ours, plain, plain);
        ensure!(
            self.found == self.plain_found,
            "the contact query finds other contacts with SIMD than without"
        );
        self.query.push(ours);
        self.n_queries += 1;
        let touches = self.found.iter().any(|f| !f.is_empty());
        if self.n_queries.is_multiple_of(EVERY[0]) && touches && self.everywhere.is_open() {
            self.compare(model, poses, scene, ours)?;
        }
        Ok(ours)
    }

    fn query_plainly(&mut self, model: &ToolModel, poses: &[Pose; 2], scene: &ContactScene) -> f64 {
        let (near, found) = (&mut self.plain_near, &mut self.plain_found);
        in_ms(|| query::<f32>(model, poses, scene, near, found)).1
    }

    fn compare(
        &mut self,
        model: &ToolModel,
        poses: &[Pose; 2],
        scene: &ContactScene,
        ours: f64,
    ) -> Result<()> {
        let all = 0..scene.shell.n_cells() as u32;
        let mut spent = [0.0; 2];
        let hash = hashed(scene.shell, scene.deformation);
        for (t, found) in self.found.iter().enumerate() {
            let (shape, pose) = (&model.tools[t].shape, &poses[t]);
            let (in_box, ms) = in_ms(|| one_by_one(shape, pose, scene, in_box(shape, pose, &hash)));
            spent[0] += ms;
            let (everywhere, ms) = in_ms(|| one_by_one(shape, pose, scene, all.clone()));
            spent[1] += ms;
            let depth = found.iter().map(|c| f64::from(c.depth)).sum();
            let ours = Found {
                n: found.len(),
                depth,
            };
            for theirs in [in_box, everywhere] {
                ours.check(&theirs)?;
            }
        }
        self.in_box.push(ours, spent[0], spent[0]);
        self.everywhere.push(ours, spent[1], spent[1]);
        Ok(())
    }

    /// Follows the bone to a new state.
    ///
    /// # Errors
    /// A baseline that finds a point outside its cell's volume.
    pub fn update(&mut self, bone: &Bone, state: &BoneState) -> Result<()> {
        self.moved.clone_from(state);
        let (moved, volumes) = (&mut self.moved, &mut self.volumes);
        let ((), ours) = in_ms(|| {
            bone.deform(moved);
            volumes.update(&bone.shell, &moved.deformation);
        });
        self.update.push(ours);
        self.n_updates += 1;
        if self.n_updates.is_multiple_of(EVERY[1]) && self.every_point.is_open() {
            let (points, baseline) = in_ms(|| {
                bone.deform(moved);
                let points = moved_points(&bone.shell, &moved.deformation);
                std::hint::black_box(hashed(&bone.shell, &moved.deformation));
                points
            });
            self.every_point.push(ours, baseline, ours + baseline);
            check_volumes(&bone.shell, volumes, &points)?;
        }
        Ok(())
    }

    /// The rows.
    pub fn rows(self) -> [Row; 2] {
        [
            Row::new(Part::CollisionQuery, self.query)
                .against(self.in_box)
                .against(self.everywhere)
                .against(self.plain),
            Row::new(Part::CollisionUpdate, self.update).against(self.every_point),
        ]
    }
}

/// Both tools' contacts, with so many points at a time.
fn query<L: Lanes>(
    model: &ToolModel,
    poses: &[Pose; 2],
    scene: &ContactScene,
    near: &mut [NearPoints; 2],
    found: &mut [Vec<Contact>; 2],
) {
    for t in 0..2 {
        let (shape, pose) = (&model.tools[t].shape, &poses[t]);
        near[t].follow_in::<L>(shape, pose, scene);
        penetrations_in::<L>(shape, pose, &near[t], &mut found[t]);
    }
}

/// Points of the bone inside a shape, in short.
#[derive(Debug)]
struct Found {
    n: usize,
    /// Sum \[mm\].
    depth: f64,
}

impl Found {
    /// One way rounds a point on the surface in, the other out: a hundredth of the contacts, or one, may differ.
    fn check(&self, other: &Self) -> Result<()> {
        let same = self.n.abs_diff(other.n) <= 1 + self.n / 100
            && (self.depth - other.depth).abs() <= 1e-2 * self.depth.max(1.0);
        ensure!(
            same,
            "the contact query finds {self:?}, the points one by one {other:?}"
        );
        Ok(())
    }
}

/// Boxes about the cells that hold points, in a spatial hash: the paper's volumes (section 4.2).
struct Hashed {
    boxes: Vec<(u32, Aabb)>,
    hash: SpatialHash,
}

fn hashed(shell: &PointShell, deformation: &[Matrix3x4<f32>]) -> Hashed {
    let cell_box = |c: &u32| {
        let nodes = deformation[*c as usize].map(f64::from);
        let nodes: [Vec3; 4] = [0, 1, 2, 3].map(|k| nodes.column(k).into());
        // Points reach out of a cell where the mesh cuts a corner.
        let scale = 1.0 + 4.0 * f64::from(shell.overhang(*c as usize));
        let mean = nodes.iter().sum::<Vec3>() / 4.0;
        let nodes = nodes.map(|n| mean + (n - mean) * scale);
        (*c, Aabb::around(&nodes))
    };
    let boxes: Vec<(u32, Aabb)> = shell.occupied().iter().map(cell_box).collect();
    let size: f64 = boxes.iter().map(|b| b.1.extent().max()).sum();
    let hash = SpatialHash::build((size / boxes.len().max(1) as f64).max(1e-3), &boxes);
    Hashed { boxes, hash }
}

/// The cells whose boxes meet the box around a shape: what the paper's hash gives.
fn in_box(shape: &RigidShape, pose: &Pose, hashed: &Hashed) -> Vec<u32> {
    let around = shape.bounds.moved(pose);
    let mut cells = Vec::new();
    hashed.hash.query(&around, |cell| cells.push(cell));
    cells.sort_unstable();
    cells.dedup();
    let meets = |cell: &u32| {
        let place = hashed.boxes.binary_search_by_key(cell, |b| b.0);
        place.is_ok_and(|k| hashed.boxes[k].1.overlaps(&around))
    };
    cells.retain(meets);
    cells
}

/// The bone's points inside a shape among those of some cells: one matrix a cell takes its points to the shape's frame, where
/// each is looked up in the distance field (paper, equation 9).
fn one_by_one(
    shape: &RigidShape,
    pose: &Pose,
    scene: &ContactScene,
    cells: impl IntoIterator<Item = u32>,
) -> Found {
    let into = pose.inverse();
    let mut found = Found { n: 0, depth: 0.0 };
    for cell in cells {
        let mut m = Matrix3x4::<f32>::zeros();
        let corners = scene.deformation[cell as usize].column_iter();
        for (mut to, from) in m.column_iter_mut().zip(corners) {
            let p = into.rotation * from.map(f64::from) + into.translation.vector;
            to.copy_from(&p.map(|v| v as f32));
        }
        for k in scene.shell.places(cell as usize..cell as usize + 1) {
            let (Some(weights), Some(normal)) = (scene.shell.weights(k), scene.shell.normal(k))
            else {
                continue;
            };
            let wall = (normal != [0.0; 3]).then(|| {
                let n = into.rotation * Vec3::from(normal.map(f64::from));
                <[f32; 3]>::from(n.map(|v| v as f32))
            });
            let at = <[f32; 3]>::from(m * nalgebra::Vector4::from(weights));
            if let Some(sample) = shape.penetration(at, wall.as_ref()) {
                found.n += 1;
                found.depth -= f64::from(sample.distance);
            }
        }
    }
    found
}

/// Each point with its cell.
fn moved_points(shell: &PointShell, deformation: &[Matrix3x4<f32>]) -> Vec<(u32, Vec3)> {
    let mut points = Vec::with_capacity(shell.len());
    for (cell, d) in deformation.iter().enumerate().take(shell.n_cells()) {
        let weights = shell
            .places(cell..cell + 1)
            .filter_map(|k| shell.weights(k));
        let moved = weights.map(|w| (d * nalgebra::Vector4::from(w)).map(f64::from));
        points.extend(moved.map(|p| (cell as u32, p)));
    }
    points
}

/// Sampled points are in the volumes of their cells.
fn check_volumes(
    shell: &PointShell,
    volumes: &BoundingVolumes,
    points: &[(u32, Vec3)],
) -> Result<()> {
    ensure!(
        points.len() == shell.len(),
        "{} of {} points moved",
        points.len(),
        shell.len()
    );
    // Points are f32.
    const ROUNDING: f64 = 1e-3;
    for (cell, p) in points.iter().step_by(97) {
        let place = shell.occupied().binary_search(cell);
        let ball = place.ok().and_then(|k| volumes.ball(k));
        let is_in = ball.is_some_and(|(centre, radius)| {
            (p - Vec3::from(centre.map(f64::from))).norm() <= f64::from(radius) + ROUNDING
        });
        ensure!(is_in, "a point at {p:?} is not in its cell's volume");
    }
    Ok(())
}
