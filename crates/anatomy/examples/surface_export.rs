//! Writes the parametric mandible's bone and its crowns as two STL files \[mm, LPS\].
//!
//! `cargo run --release -p osteotome-anatomy --example surface_export BONE.stl TEETH.stl`
use osteotome_anatomy::{Parameters, ParametricMandible, mesher, stl};
use osteotome_mechanics::geometry::TriMesh;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(bone), Some(teeth)) = (arguments.next(), arguments.next()) else {
        return Err("give two file names, BONE.stl and TEETH.stl".into());
    };
    let mandible = ParametricMandible::new(Parameters::default())?;
    let surface = mesher::contour(&mandible, 1.2)?;
    std::fs::write(bone, stl::to_binary_stl(&surface))?;
    let mut crowns = TriMesh::default();
    for crown in mandible.teeth() {
        let n = crowns.vertices.len() as u32;
        let part = crown.surface()?;
        crowns.vertices.extend(part.vertices);
        crowns
            .triangles
            .extend(part.triangles.iter().map(|t| t.map(|v| v + n)));
    }
    std::fs::write(teeth, stl::to_binary_stl(&crowns))?;
    Ok(())
}
