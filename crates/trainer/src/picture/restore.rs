//! The bone of any generation, rebuilt from what `/crack` holds by the product's own growth.
use crate::session::GrowthSample;
use anyhow::{Context, Result, bail};
use osteotome_mechanics::crack::{CrackedBody, Growth};
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use std::borrow::Borrow;
use std::sync::Arc;

/// A body that can be led through its recorded growths.
pub struct Restored {
    sawn: CrackedBody,
    now: Arc<CrackedBody>,
    generation: usize,
}

impl Restored {
    /// From the sawn, unbroken body.
    pub fn new(sawn: &CrackedBody) -> Self {
        Self {
            sawn: sawn.clone(),
            now: Arc::new(sawn.clone()),
            generation: 0,
        }
    }

    /// The body of the generation led to.
    pub fn body(&self) -> &CrackedBody {
        &self.now
    }

    /// The same, to keep.
    pub fn shared(&self) -> Arc<CrackedBody> {
        self.now.clone()
    }

    /// Goes to a generation, `growth[k]` being what led to generation `k`. Cheapest upwards.
    ///
    /// # Errors
    /// A recording that lacks growths, or does not fit the body.
    pub fn go_to(&mut self, generation: usize, growth: &[impl Borrow<GrowthSample>]) -> Result<()> {
        if generation < self.generation {
            self.now = Arc::new(self.sawn.clone());
            self.generation = 0;
        }
        while self.generation < generation {
            let k = self.generation + 1;
            let next = growth.get(k).map(Borrow::borrow);
            let next = next.filter(|g| g.generation == k as u64);
            let next = next.with_context(|| format!("growth {k} of the crack is not recorded"))?;
            let grown = growth_of(&self.now, next)?;
            self.now = Arc::new(self.now.grown(grown)?);
            self.generation = k;
        }
        Ok(())
    }
}

fn growth_of(before: &CrackedBody, sample: &GrowthSample) -> Result<Growth> {
    let mesh = &before.solid.mesh;
    let edges_fit =
        |(e, s): &(u32, f64)| (*e as usize) < mesh.edges().len() && *s > 0.0 && *s < 1.0;
    let seats_fit = |(n, p): &(u32, [f64; 3])| {
        (*n as usize) < mesh.nodes().len() && p.iter().all(|c| c.is_finite())
    };
    if !sample.cut.iter().all(edges_fit) || !sample.seats.iter().all(seats_fit) {
        bail!("a recorded cut names an edge or a node that the bone does not have");
    }
    let mut cuts = before.cuts.clone();
    let seats: Vec<(u32, Vec3)> = sample
        .seats
        .iter()
        .map(|(n, p)| (*n, Vec3::from(*p)))
        .collect();
    let newly_cut = cuts.restore(&sample.cut, &seats);
    let mut crack = before.crack.clone();
    if sample.sheets.len() != crack.sheets.len() {
        bail!("the crack was recorded without its sheets; record the session again");
    }
    let (mut vertex, mut triangle) = (0, 0);
    for (sheet, counts) in crack.sheets.iter_mut().zip(&sample.sheets) {
        let [nv, nt] = counts.map(|n| n as usize);
        let vertices = sample.vertices.get(vertex..vertex + nv);
        let kerf = sample.kerf.get(vertex..vertex + nv);
        let triangles = sample.triangles.get(triangle..triangle + nt);
        let (Some(vertices), Some(kerf), Some(triangles)) = (vertices, kerf, triangles) else {
            bail!("a recorded sheet has fewer vertices or triangles than it says");
        };
        let own = |v: u32| v.checked_sub(vertex as u32).filter(|v| (*v as usize) < nv);
        let own: Option<Vec<[u32; 3]>> = triangles
            .iter()
            .map(|t| Some([own(t[0])?, own(t[1])?, own(t[2])?]))
            .collect();
        sheet.mesh = TriMesh {
            vertices: vertices.iter().map(|p| Vec3::from(*p)).collect(),
            triangles: own.context("a recorded sheet's triangle names another sheet's vertex")?,
        };
        sheet.kerf = kerf.to_vec();
        (vertex, triangle) = (vertex + nv, triangle + nt);
    }
    Ok(Growth {
        crack,
        cuts,
        newly_cut,
    })
}
