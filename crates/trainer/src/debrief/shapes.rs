//! What the page's own 3D view draws: the bone's final skins, how their nodes moved through the session, and the tools.
//!
//! A vertex moves with four virtual nodes; only these are sent for each moment, so that a session of minutes stays small.
use super::course::Course;
use super::hands::stride;
use super::packed::{floats, indices, shorts};
use crate::engine::Prepared;
use crate::picture::{Anchor, Places, Skin, Skins, away, chisel, piece_of};
use crate::session::Recording;
use anyhow::Result;
use osteotome_mechanics::geometry::{MeshDistance, Pose, Vec3};
use osteotome_mechanics::tool::Chisel;
use serde::Serialize;
use std::collections::BTreeMap;

/// The whole view.
#[derive(Serialize)]
pub struct Shapes {
    parts: Vec<Part>,
    /// Unit of `frames` \[mm\].
    unit: f64,
    n_nodes: usize,
    times: String,
    /// For each time, each node's displacement.
    frames: String,
    /// Of each fragment, away from the others.
    away: Vec<[f32; 3]>,
    tools: [Tool; 2],
    /// Between two poses \[s\].
    pose_step: f64,
    target: [f64; 3],
    radius: f64,
    /// Side of the patient: -1 right, 1 left.
    side: f64,
}

/// One mesh that moves with the bone.
#[derive(Serialize)]
struct Part {
    kind: &'static str,
    /// Undeformed corners \[mm\].
    rest: String,
    /// Four virtual nodes a vertex.
    nodes: String,
    /// Their weights, in [`WEIGHT`].
    weights: String,
    fragments: String,
    triangles: String,
    /// When each vertex was there \[s\]; empty: always.
    born: String,
}

#[derive(Serialize)]
struct Tool {
    positions: String,
    triangles: String,
    /// Position and quaternion (x, y, z, w).
    poses: String,
}

/// Unit of weights.
const WEIGHT: f64 = 1.0 / 8192.0;
/// Most numbers of displacement that are sent.
const BUDGET: usize = 1_200_000;
/// Most poses of a tool that are sent.
const MOST_POSES: usize = 8000;

/// Virtual nodes, numbered as they are met.
#[derive(Default)]
struct Nodes {
    number: BTreeMap<(u32, u32), u32>,
    /// A cell and corner for each.
    seen: Vec<(u32, usize)>,
}

impl Shapes {
    /// From a session. `canal`: the operated side's line, if known.
    pub fn of(
        course: &Course,
        prepared: &Prepared,
        recording: &Recording,
        chisels: &[Chisel; 2],
        canal: Option<&[Vec3]>,
    ) -> Result<Self> {
        let body = course.body();
        let skins = Skins::of(
            body,
            prepared,
            &Places::new(body, &prepared.patient.surface),
        );
        let mut nodes = Nodes::default();
        let (born, _) = course.births()?;
        let bone = MeshDistance::new(prepared.patient.surface.clone());
        let mut gap = skins.gap.skin.clone();
        gap.rest.iter_mut().for_each(|p| trim(&bone, p));
        let mut parts = vec![
            nodes.part(
                course,
                "bone",
                &skins.bone.skin,
                &skins.bone.skin.triangles,
                &[],
            ),
            nodes.part(course, "broken", &gap, &skins.gap.skin.triangles, &[]),
            nodes.part(course, "sawn", &gap, &skins.gap.sawn, &[]),
            nodes.part(
                course,
                "crack",
                &skins.broken,
                &skins.broken.triangles,
                &born,
            ),
            nodes.part(course, "teeth", &skins.teeth, &skins.teeth.triangles, &[]),
        ];
        if let Some(line) = canal {
            let tube = tube(course, line, 1.2);
            parts.push(nodes.part(course, "canal", &tube, &tube.triangles, &[]));
        }
        let all = course.times();
        let most = (BUDGET / (3 * nodes.seen.len()).max(1)).clamp(2, 600);
        let every = all.len().div_ceil(most).max(1);
        let shown: Vec<usize> = (0..all.len())
            .filter(|k| k % every == 0 || *k + 1 == all.len())
            .collect();
        let frames: Vec<Vec<Vec3>> = shown
            .iter()
            .map(|k| nodes.displacements(course, *k))
            .collect();
        let largest = frames.iter().flatten().map(Vec3::amax).fold(1e-3, f64::max);
        let unit = largest / 32767.0;
        let marks = prepared.patient.osteotomy.place();
        let target = marks.iter().sum::<Vec3>() / marks.len() as f64;
        let reach = marks
            .iter()
            .map(|m| (m - target).norm())
            .fold(10.0, f64::max);
        let scenario = &recording.scenario.scenario;
        let n_steps = recording.hands[0].len();
        let pose_stride = stride(scenario).max(n_steps.div_ceil(MOST_POSES));
        let tool = |i: usize| tool(&chisels[i], recording, i, pose_stride);
        Ok(Self {
            parts,
            unit,
            n_nodes: nodes.seen.len(),
            times: floats(shown.iter().map(|k| all[*k])),
            frames: shorts(frames.iter().flatten().flat_map(|v| [v.x, v.y, v.z]), unit),
            away: away(body, &skins.gap)
                .iter()
                .map(|v| v.cast::<f32>().into())
                .collect(),
            tools: [tool(0), tool(1)],
            pose_step: pose_stride as f64 * scenario.loops.dt(),
            target: target.into(),
            radius: 1.7 * reach,
            side: prepared.patient.osteotomy.side.sign(),
        })
    }
}

impl Nodes {
    fn of(&mut self, course: &Course, cell: u32) -> [u32; 4] {
        let body = course.body();
        let own = &body.topology.cells()[cell as usize];
        let corners = body.solid.mesh.tets()[own.tet as usize];
        [0, 1, 2, 3].map(|k| {
            let next = self.seen.len() as u32;
            let key = (corners[k], own.enrichment[k]);
            *self.number.entry(key).or_insert_with(|| {
                self.seen.push((cell, k));
                next
            })
        })
    }

    /// Vertices that no triangle uses are left out.
    fn part(
        &mut self,
        course: &Course,
        kind: &'static str,
        skin: &Skin,
        triangles: &[[u32; 3]],
        born: &[f64],
    ) -> Part {
        let mut new = vec![None; skin.anchors.len()];
        let mut used: Vec<u32> = vec![];
        let mut renumber = |v: u32| {
            *new[v as usize].get_or_insert_with(|| {
                used.push(v);
                used.len() as u32 - 1
            })
        };
        let triangles: Vec<u32> = triangles.iter().flatten().map(|v| renumber(*v)).collect();
        let anchors: Vec<Anchor> = used.iter().map(|v| skin.anchors[*v as usize]).collect();
        let rest = used
            .iter()
            .flat_map(|v| skin.rest[*v as usize])
            .map(f64::from);
        let nodes: Vec<u32> = anchors
            .iter()
            .flat_map(|a| self.of(course, a.cell))
            .collect();
        let fragment = |a: &Anchor| f64::from(piece_of(course.body(), a.cell));
        // What was added where fragments parted came last.
        let last = born.iter().copied().fold(0.0, f64::max);
        let of_used = used.iter().filter(|_| !born.is_empty());
        let born = of_used.map(|v| born.get(*v as usize).copied().unwrap_or(last));
        Part {
            kind,
            rest: floats(rest),
            nodes: indices(nodes),
            weights: shorts(anchors.iter().flat_map(|a| a.weights), WEIGHT),
            fragments: shorts(anchors.iter().map(fragment), 1.0),
            triangles: indices(triangles),
            born: floats(born),
        }
    }

    fn displacements(&self, course: &Course, state: usize) -> Vec<Vec3> {
        let body = course.body();
        let x = course.unknowns(state);
        let of = |(cell, k): &(u32, usize)| {
            let cell = &body.topology.cells()[*cell as usize];
            body.system.cell_displacements(&body.solid.mesh, cell, &x)[*k]
        };
        self.seen.iter().map(of).collect()
    }
}

/// The faces of the crack are led on out of the bone; here they end at its surface.
fn trim(bone: &MeshDistance, p: &mut [f32; 3]) {
    let at = Vec3::from(p.map(f64::from));
    if bone.signed(&at) > 0.0
        && let Some(on) = bone.closest(&at)
    {
        *p = on.point.cast::<f32>().into();
    }
}

/// A tube about a line in the bone.
fn tube(course: &Course, line: &[Vec3], radius: f64) -> Skin {
    const SIDES: u32 = 8;
    let mut skin = Skin::default();
    for (i, p) in line.iter().enumerate() {
        let along = line[(i + 1).min(line.len() - 1)] - line[i.saturating_sub(1)];
        let u = along
            .cross(&Vec3::x())
            .try_normalize(1e-9)
            .unwrap_or_else(Vec3::y);
        let v = along.cross(&u).try_normalize(1e-9).unwrap_or_else(Vec3::z);
        let anchor = course.anchor(p);
        let mesh = &course.body().solid.mesh;
        let tet = course.body().topology.cells()[anchor.cell as usize].tet;
        for k in 0..SIDES {
            let a = std::f64::consts::TAU * f64::from(k) / f64::from(SIDES);
            let at = p + (u * a.cos() + v * a.sin()) * radius;
            let weights = mesh.barycentric(tet as usize, &at);
            skin.push(Anchor { weights, ..anchor }, &at);
        }
    }
    for ring in 1..line.len() as u32 {
        for k in 0..SIDES {
            let next = (k + 1) % SIDES;
            let [a, b] = [(ring - 1) * SIDES, ring * SIDES];
            skin.triangles
                .extend([[a + k, a + next, b + next], [a + k, b + next, b + k]]);
        }
    }
    skin
}

fn tool(shape: &Chisel, recording: &Recording, i: usize, every: usize) -> Tool {
    let (mut positions, mut triangles) = (vec![], vec![]);
    for prop in chisel(shape, &Pose::identity()) {
        let first = (positions.len() / 3) as u32;
        positions.extend(prop.positions.iter().flatten().map(|c| f64::from(*c)));
        triangles.extend(prop.triangles.iter().flatten().map(|v| v + first));
    }
    let poses = recording.hands[i].iter().step_by(every).flat_map(|hand| {
        let (p, q) = (
            hand.tool_pose.translation.vector,
            hand.tool_pose.rotation.coords,
        );
        [p.x, p.y, p.z, q.x, q.y, q.z, q.w]
    });
    Tool {
        positions: floats(positions),
        triangles: indices(triangles),
        poses: floats(poses),
    }
}
