//! Writes the parametric mandible as files that `osteotome prepare` takes: jaw.stl, teeth.stl, landmarks.json and both canals
//! \[mm, LPS\].
//!
//! `cargo run --release -p osteotome-anatomy --example surface_export FOLDER`
use osteotome_anatomy::{Parameters, ParametricMandible, Side, mesher, stl};
use osteotome_mechanics::geometry::{MeshDistance, TriMesh};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("give a folder")?;
    let folder = PathBuf::from(folder);
    std::fs::create_dir_all(&folder)?;
    let mandible = ParametricMandible::new(Parameters::default())?;
    let surface = mesher::contour(&mandible, 1.2)?;
    std::fs::write(folder.join("jaw.stl"), stl::to_binary_stl(&surface))?;
    let mut crowns = TriMesh::default();
    for crown in mandible.teeth() {
        crowns.append(&crown.surface()?);
    }
    std::fs::write(folder.join("teeth.stl"), stl::to_binary_stl(&crowns))?;
    let marks = mandible.landmarks(&MeshDistance::new(surface))?.to_file();
    std::fs::write(
        folder.join("landmarks.json"),
        serde_json::to_vec_pretty(&marks)?,
    )?;
    for canal in mandible.canals() {
        let name = match canal.side {
            Side::Right => "canal_right.json",
            Side::Left => "canal_left.json",
        };
        let json = serde_json::to_vec_pretty(&canal.to_file())?;
        std::fs::write(folder.join(name), json)?;
    }
    Ok(())
}
