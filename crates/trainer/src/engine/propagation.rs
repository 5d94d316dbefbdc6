use super::rebase::Rebase;
use crate::loops::{Propagated, PropagationPart, Published, Seen, Subscribed};
use crate::session::{FrontPoint, GrowthSample};
use osteotome_mechanics::crack::{CutEdges, bridging_edges};
use osteotome_mechanics::geometry::Vec3;
use osteotome_mechanics::step::{
    Bone, BoneState, GrowthReport, PropagationSettings, Rest, propagation_step,
};
use std::sync::Arc;

/// A state of the bone, numbered.
#[derive(Clone)]
pub struct Loaded {
    /// Counts the main steps.
    pub serial: u64,
    /// The state.
    pub state: BoneState,
}

/// A load whose strain energy has changed by a smaller share does not move a crack that rested under it.
const SAME_LOAD: f64 = 0.01;

/// The propagation loop's part.
pub struct Propagation {
    bone: Arc<Bone>,
    sawn_area: f64,
    settings: PropagationSettings,
    state: Subscribed<Loaded>,
    pub(super) grown: Published<Arc<Bone>>,
    seen: u64,
    /// How often the fronts were looked at.
    n_looks: u64,
    /// Strain energy \[N mm\] at which the bone as it is was last found to rest.
    rested: Option<f64>,
    /// The last load under which growths of the bone as it is were tried in vain.
    tried: Option<Rest>,
    rebase: Rebase,
    /// Why the crack cannot go on, if a grown bone could not be computed.
    stuck: Option<String>,
}

impl Propagation {
    pub(super) fn new(
        bone: Arc<Bone>,
        state: Subscribed<Loaded>,
        grown: Published<Arc<Bone>>,
    ) -> Self {
        Self {
            sawn_area: bone.crack_area(),
            bone,
            settings: PropagationSettings::default(),
            state,
            grown,
            seen: 0,
            n_looks: 0,
            rested: None,
            tried: None,
            rebase: Rebase::default(),
            stuck: None,
        }
    }

    /// How many steps have looked at the crack fronts: all but those that had nothing new, or a load under which the crack rests.
    pub fn n_looks(&self) -> u64 {
        self.n_looks
    }

    /// The crack as it is, and what has been cut since `before`.
    fn sample(&self, report: &GrowthReport, before: Option<&CutEdges>) -> GrowthSample {
        let bone = &self.bone;
        let (mut vertices, mut triangles, mut kerf) = (vec![], vec![], vec![]);
        for sheet in &bone.crack.sheets {
            let first = vertices.len() as u32;
            vertices.extend(sheet.mesh.vertices.iter().map(|v| <[f64; 3]>::from(*v)));
            triangles.extend(sheet.mesh.triangles.iter().map(|t| t.map(|v| v + first)));
            kerf.extend_from_slice(&sheet.kerf);
        }
        let n_edges = bone.body.mesh.edges().len() as u32;
        let since = |b| cut_since(&bone.cuts, b, n_edges);
        let (cut, seats) = before.map_or_else(Default::default, since);
        let front = report.fronts.iter().flatten().filter(|p| p.inside);
        GrowthSample {
            time: 0.0,
            vertices,
            triangles,
            kerf,
            generation: bone.generation.into(),
            front: front
                .map(|p| FrontPoint {
                    position: p.position.into(),
                    k: p.k,
                    g: p.g,
                    angle: p.angle,
                })
                .collect(),
            area: bone.crack_area() - self.sawn_area,
            fragments: bone.fragments.count(),
            severed: bone.is_severed(),
            sheets: (bone.crack.sheets.iter())
                .map(|s| [s.mesh.vertices.len(), s.mesh.triangles.len()].map(|n| n as u32))
                .collect(),
            cut,
            seats,
            tips: tips(bone),
        }
    }
}

impl PropagationPart for Propagation {
    fn seen(&self) -> Seen {
        Seen {
            state: self.seen,
            generation: None,
        }
    }

    fn crack(&self) -> GrowthSample {
        self.sample(&GrowthReport::default(), None)
    }

    fn step(&mut self) -> Propagated {
        let loaded = self.state.read();
        let is_new = loaded.serial != self.seen;
        self.seen = loaded.serial;
        let is_ours = loaded.state.generation == self.bone.generation;
        if !is_new || !is_ours || !loaded.state.converged || self.stuck.is_some() {
            return Propagated::Idle;
        }
        let energy = loaded.state.strain_energy;
        let is_same = |rested: f64| (energy - rested).abs() < SAME_LOAD * rested;
        if self.rested.is_some_and(is_same) {
            return Propagated::Checked;
        }
        self.rested = Some(energy);
        self.n_looks += 1;
        let tried = self.tried.as_ref();
        match propagation_step(&self.bone, &loaded.state, &self.settings, tried) {
            Ok((Some(mut next), report)) => {
                (self.rested, self.tried) = (None, None);
                self.rebase.follow(&mut next);
                let before = std::mem::replace(&mut self.bone, Arc::new(next));
                self.grown.write(Arc::clone(&self.bone));
                Propagated::Grown(Box::new(self.sample(&report, Some(&before.cuts))))
            }
            Ok((None, report)) => {
                self.tried = report.rest;
                Propagated::Checked
            }
            Err(error) => {
                self.stuck = Some(error.to_string());
                Propagated::Checked
            }
        }
    }

    fn fault(&self) -> Option<String> {
        let error = self.stuck.as_ref()?;
        Some(format!("the crack stopped growing: {error}"))
    }
}

/// Edges with their crossings, and nodes with their seats.
pub type CutsAndSeats = (Vec<(u32, f64)>, Vec<(u32, [f64; 3])>);

/// What has been cut and seated beyond an earlier generation of a mesh with `n_edges` edges.
pub fn cut_since(cuts: &CutEdges, before: &CutEdges, n_edges: u32) -> CutsAndSeats {
    let is_new = |e: &u32| cuts.is_cut(*e) && !before.is_cut(*e);
    let cut = (0..n_edges).filter(is_new).map(|e| (e, cuts.crossing(e)));
    let old: Vec<u32> = before.seats().map(|s| s.0).collect();
    let seats = cuts.seats().filter(|s| old.binary_search(&s.0).is_err());
    (cut.collect(), seats.map(|(n, p)| (n, p.into())).collect())
}

/// Where the bone still holds: front vertices inside it, or the middles of the last edges that bridge the split.
fn tips(bone: &Bone) -> Vec<Vec3> {
    let body = &bone.body;
    let fronts = bone
        .crack
        .fronts(&body.mesh, &body.locator, body.lengths.stick());
    let tips: Vec<Vec3> = fronts
        .iter()
        .flat_map(|f| {
            f.vertices
                .iter()
                .map(|v| bone.crack.sheets[f.sheet].mesh.vertices[*v as usize])
        })
        .filter(|p| body.locator.find(&body.mesh, p).is_some())
        .collect();
    if !tips.is_empty() || bone.is_severed() {
        return tips;
    }
    const MANY: usize = 64;
    let [source, sink] = &body.ends;
    let edges = bridging_edges(&body.mesh, &bone.cuts, source, sink, MANY).unwrap_or_default();
    let middle = |e: &u32| {
        let [a, b] = body.mesh.edges()[*e as usize].map(|n| body.mesh.nodes()[n as usize]);
        0.5 * (a + b)
    };
    edges.iter().map(middle).collect()
}
