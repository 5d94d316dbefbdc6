//! How far a mesh lies from the surface that it stands for.
use crate::error::AnatomyError;
use crate::point_shell::point_shell;
use osteotome_mechanics::geometry::{MeshDistance, TetMesh, TriMesh};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Distances \[mm\] of points spread evenly over one surface from another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// 95 of 100 are nearer.
    pub p95: f64,
    /// The farthest.
    pub max: f64,
}

/// How far two surfaces lie apart, both ways.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Deviation {
    /// Of the mesh's boundary from the surface.
    pub of_mesh: Spread,
    /// Of the surface from the mesh's boundary.
    pub of_surface: Spread,
}

/// Points on each of the two surfaces.
const POINTS: usize = 40_000;

impl Deviation {
    /// Between two surfaces.
    ///
    /// # Errors
    /// [`AnatomyError::EmptySurface`] for a surface without area.
    pub fn between(mesh: &MeshDistance, surface: &MeshDistance) -> Result<Self, AnatomyError> {
        Ok(Self {
            of_mesh: spread(mesh.mesh(), surface)?,
            of_surface: spread(surface.mesh(), mesh)?,
        })
    }

    /// Of a tetrahedral mesh's boundary.
    ///
    /// # Errors
    /// As [`between`](Self::between).
    pub fn of(mesh: &TetMesh, surface: &MeshDistance) -> Result<Self, AnatomyError> {
        Self::between(&MeshDistance::new(boundary(mesh)), surface)
    }

    /// The larger of both.
    pub fn p95(&self) -> f64 {
        self.of_mesh.p95.max(self.of_surface.p95)
    }
}

/// The boundary of a tetrahedral mesh, with all its nodes.
pub(crate) fn boundary(mesh: &TetMesh) -> TriMesh {
    TriMesh {
        vertices: mesh.nodes().to_vec(),
        triangles: mesh.boundary_faces().to_vec(),
    }
}

fn spread(from: &TriMesh, to: &MeshDistance) -> Result<Spread, AnatomyError> {
    let mut distances: Vec<f64> = point_shell(from, POINTS)?
        .par_iter()
        .map(|p| to.unsigned(&p.position))
        .collect();
    distances.sort_by(f64::total_cmp);
    let n = distances.len();
    Ok(Spread {
        mean: distances.iter().sum::<f64>() / n as f64,
        p95: distances[(0.95 * (n - 1) as f64).round() as usize],
        max: distances[n - 1],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteotome_mechanics::geometry::{Vec3, block_mesh};

    #[test]
    fn a_shifted_block_deviates_by_the_shift_on_two_faces_of_six() {
        let block = block_mesh(Vec3::zeros(), Vec3::repeat(10.0), [2, 2, 2]);
        let mut moved = boundary(&block);
        moved.vertices.iter_mut().for_each(|p| p.x += 0.5);
        let deviation = Deviation::of(&block, &MeshDistance::new(moved)).unwrap();
        for side in [deviation.of_mesh, deviation.of_surface] {
            assert!((side.max - 0.5).abs() < 1e-9 && (side.p95 - 0.5).abs() < 1e-9);
            // Two faces lie half a millimetre off, of the others a rim by less.
            assert!((side.mean - 0.5 / 3.0).abs() < 0.02, "{}", side.mean);
        }
    }
}
