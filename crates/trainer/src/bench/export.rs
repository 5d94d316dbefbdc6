//! What `benches/peers` gives to other programs: the equations with our ordering, and chisels against the surface.
use super::times::Times;
use crate::engine::Prepared;
use crate::scenario::Scenario;
use crate::session::HandSample;
use anyhow::{Context, Result};
use osteotome_mechanics::bone::{BlockMatrix, Factor};
use osteotome_mechanics::crack::System;
use osteotome_mechanics::geometry::{Pose, TriMesh};
use osteotome_mechanics::step::Bone;
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

/// A pose is kept at every so many haptic steps.
pub const EVERY: u64 = 25;
/// Times of factor and solve are the least of so many.
const REPEATS: usize = 5;

/// Where the tools were, and what our contact query found there.
#[derive(Clone, Debug, Serialize)]
pub struct Touch {
    /// Position \[mm\] and quaternion x, y, z, w of each tool.
    tools: [([f64; 3], [f64; 4]); 2],
    /// Bone points inside both tools.
    contacts: u32,
    /// Our query of both tools \[ms\].
    query_ms: f64,
}

impl Touch {
    /// From both hands and the time of the query \[ms\].
    pub fn new(hands: &[HandSample; 2], query_ms: f64) -> Self {
        let form = |p: &Pose| (p.translation.vector.into(), p.rotation.coords.into());
        Self {
            tools: hands.each_ref().map(|h| form(&h.tool_pose)),
            contacts: hands.iter().map(|h| h.contacts).sum(),
            query_ms,
        }
    }
}

#[derive(Serialize)]
struct Ours<'a> {
    nodes: usize,
    unknowns: usize,
    factor_values: usize,
    /// Ordering, analysis and numbers \[ms\].
    factor_ms: f64,
    /// One right-hand side \[ms\].
    solve_ms: f64,
    touches: &'a [Touch],
}

/// Writes the equations of the bone as it ended, our times, and the touches into `folder`.
///
/// # Errors
/// Whatever the file system says, and equations that cannot be factored.
pub fn write(
    prepared: &Prepared,
    scenario: &Scenario,
    bone: &Bone,
    touches: &[Touch],
    folder: &Path,
) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text).with_context(|| path.display().to_string())
    };
    let solid = &bone.body.solid;
    let system = System::new(
        &solid.mesh,
        &solid.materials,
        &bone.topology,
        &solid.supports,
    )?;
    let (matrix, positions) = system.base(&solid.mesh, &bone.topology);
    let factor = Factor::new(&matrix, &positions)?;
    let factor_ms = least(|| Factor::new(&matrix, &positions));
    let (mut x, mut scratch) = (vec![1.0; system.n()], system.scratch());
    let solve_ms = least(|| system.solve(&mut x, &mut scratch));
    write("stiffness.mtx", &matrix_market(&matrix)?)?;
    let ordering: Vec<String> = factor.ordering().iter().map(u32::to_string).collect();
    write("ordering.txt", &(ordering.join("\n") + "\n"))?;
    write("surface.obj", &obj(&prepared.patient.surface)?)?;
    for i in 0..2 {
        let chisel = crate::engine::chisel(&scenario.tool[i])?;
        write(&format!("chisel_{i}.obj"), &obj(&chisel.surface())?)?;
    }
    let ours = Ours {
        nodes: solid.mesh.nodes().len(),
        unknowns: system.n(),
        factor_values: factor.n_values(),
        factor_ms,
        solve_ms,
        touches,
    };
    write("ours.json", &serde_json::to_string_pretty(&ours)?)
}

fn least<T>(mut work: impl FnMut() -> T) -> f64 {
    let mut times = Times::default();
    for _ in 0..REPEATS {
        let start = Instant::now();
        std::hint::black_box(work());
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times.in_short().map_or(f64::NAN, |t| t.min)
}

/// The lower triangle, unknown by unknown.
fn matrix_market(matrix: &BlockMatrix) -> Result<String> {
    let n = 3 * matrix.n_blocks();
    let mut entries = String::new();
    let mut count = 0;
    for (row, col, block) in matrix.iter() {
        for c in 0..3 {
            for r in if row == col { c } else { 0 }..3 {
                let (i, j) = (3 * row as usize + r + 1, 3 * col as usize + c + 1);
                writeln!(entries, "{i} {j} {:e}", block[(r, c)])?;
                count += 1;
            }
        }
    }
    Ok(format!(
        "%%MatrixMarket matrix coordinate real symmetric\n{n} {n} {count}\n{entries}"
    ))
}

fn obj(mesh: &TriMesh) -> Result<String> {
    let mut text = String::new();
    for v in &mesh.vertices {
        writeln!(text, "v {} {} {}", v.x, v.y, v.z)?;
    }
    for [a, b, c] in mesh.triangles.iter().map(|t| t.map(|i| i + 1)) {
        writeln!(text, "f {a} {b} {c}")?;
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    #[test]
    fn a_matrix_is_written_as_its_lower_triangle() {
        let mut matrix = BlockMatrix::zeros(2, [(0, 1)]);
        matrix.add(0, 0, &Matrix3::identity());
        matrix.add(1, 0, &Matrix3::from_element(0.5));
        let text = matrix_market(&matrix).unwrap();
        let mut lines = text.lines().skip(1);
        assert_eq!(lines.next(), Some("6 6 21"));
        let entries: Vec<&str> = lines.collect();
        assert_eq!(entries.len(), 21);
        assert!(entries.contains(&"1 1 1e0") && entries.contains(&"6 3 5e-1"));
        assert!(!entries.iter().any(|e| e.starts_with("1 2 ")));
    }
}
