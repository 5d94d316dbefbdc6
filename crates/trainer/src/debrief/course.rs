//! The bone through the whole session, in the topology that it ended with.
//!
//! Displacements of nodes keep their places in the vector of unknowns and jumps of later cracks follow them, so that an
//! earlier state is a later one with zeros at the end.
use crate::engine::Prepared;
use crate::picture::{Anchor, Restored, moved_cells, piece_of, tet_at};
use crate::session::Recording;
use anyhow::{Context, Result, ensure};
use osteotome_mechanics::crack::CrackedBody;
use osteotome_mechanics::geometry::Vec3;

/// The bone's states.
pub struct Course<'a> {
    restored: Restored,
    recording: &'a Recording,
}

impl<'a> Course<'a> {
    /// Rebuilds the bone's last generation from the recording.
    ///
    /// # Errors
    /// A recording without the bone's states, or of another bone.
    pub fn new(prepared: &Prepared, recording: &'a Recording) -> Result<Self> {
        ensure!(
            !recording.bone.is_empty(),
            "the bone's displacements are not recorded; record the session again"
        );
        let mut restored = Restored::new(&prepared.bone.cracked);
        let last = recording.growth.last().map_or(0, |g| g.generation);
        restored.go_to(usize::try_from(last)?, &recording.growth)?;
        let n = restored.body().system.n();
        let fits = recording.bone.iter().all(|b| b.x_um.len() <= n);
        ensure!(
            fits,
            "a recorded state of the bone has more unknowns than the bone"
        );
        Ok(Self {
            restored,
            recording,
        })
    }

    /// The bone as it ended.
    pub fn body(&self) -> &CrackedBody {
        self.restored.body()
    }

    /// Times of the states \[s\].
    pub fn times(&self) -> Vec<f64> {
        self.recording.bone.iter().map(|b| b.time).collect()
    }

    /// The state in force at a time.
    pub fn state_at(&self, time: f64) -> usize {
        let later = self
            .recording
            .bone
            .partition_point(|b| b.time <= time + 1e-9);
        later.saturating_sub(1)
    }

    /// Unknowns of a state \[mm\].
    pub fn unknowns(&self, state: usize) -> Vec<f64> {
        let x = &self.recording.bone[state].x_um;
        let mut x: Vec<f64> = x.iter().map(|v| f64::from(*v) * 1e-3).collect();
        x.resize(self.body().system.n(), 0.0);
        x
    }

    /// Where the cells' nodes are in a state.
    pub fn moved(&self, state: usize) -> Vec<[Vec3; 4]> {
        moved_cells(self.body(), &self.unknowns(state))
    }

    /// A point's place in the bone.
    pub fn anchor(&self, p: &Vec3) -> Anchor {
        let (tet, weights) = tet_at(self.body(), p);
        let cell = self.body().topology.cell_at(tet, &weights);
        Anchor { cell, weights }
    }

    /// The fragment of a point, the largest being 0.
    pub fn fragment(&self, p: &Vec3) -> u32 {
        piece_of(self.body(), self.anchor(p).cell)
    }

    /// The fragment of an anchored point.
    pub fn fragment_of(&self, anchor: &Anchor) -> u32 {
        piece_of(self.body(), anchor.cell)
    }

    /// Of each crack vertex and triangle when it first was there \[s\].
    pub fn births(&self) -> Result<(Vec<f64>, Vec<f64>)> {
        let growth = &self.recording.growth;
        let last = growth.last().context("no crack is recorded")?;
        let mut born = (vec![], vec![]);
        for (s, [n_vertices, n_triangles]) in last.sheets.iter().enumerate() {
            let first = |i: u32, k: usize| {
                let there = growth
                    .iter()
                    .find(|g| g.sheets.get(s).is_some_and(|n| n[k] > i));
                there.map_or(last.time, |g| g.time)
            };
            born.0.extend((0..*n_vertices).map(|i| first(i, 0)));
            born.1.extend((0..*n_triangles).map(|i| first(i, 1)));
        }
        Ok(born)
    }
}

/// Where an anchored point is.
pub fn place(anchor: &Anchor, moved: &[[Vec3; 4]]) -> Vec3 {
    let nodes = &moved[anchor.cell as usize];
    (0..4).map(|k| nodes[k] * anchor.weights[k]).sum()
}
