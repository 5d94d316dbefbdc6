//! Pictures of a prepared patient.
use super::look;
use super::print::{encode_png, orientation, scale_bar};
use super::props::{Prop, tube};
use super::views::View;
use anyhow::Result;
use osteotome_anatomy::PatientFolder;
use osteotome_mechanics::geometry::TriMesh;
use osteotome_render::{
    Canvas, Kind, Material, Options, Scene, Texture, render, scene::vertex_normals,
};

/// Pixels across and down.
const SIZE: [usize; 2] = [960, 720];

/// The canal.
const NERVE: Material = Material {
    color: [0.95, 0.62, 0.05],
    opacity: 0.95,
    gloss: 0.0,
    texture: Texture::Signal,
};
/// What is around the jaw.
const AROUND: Material = Material {
    color: [0.45, 0.52, 0.60],
    opacity: 0.10,
    gloss: 0.1,
    texture: Texture::Plain,
};

/// Names and PNG bytes: from before, both sides and above, and both sides transparent with canal and surroundings.
pub fn patient_pictures(patient: &PatientFolder) -> Result<Vec<(&'static str, Vec<u8>)>> {
    let mut solid = vec![skin(Kind::Bone, look::CORTICAL, &patient.surface)];
    let teeth = patient.teeth.iter();
    solid.extend(teeth.map(|t| skin(Kind::Solid, look::TOOTH, &t.surface)));
    let mut inner = solid.clone();
    for canal in &patient.canals {
        let rings: Vec<_> = canal.line.iter().map(|p| (*p, canal.radius)).collect();
        let mut nerve = tube(NERVE, &rings);
        nerve.kind = Kind::Within;
        inner.push(nerve);
    }
    let around = patient.context.iter();
    inner.extend(around.map(|(_, mesh)| skin(Kind::Solid, AROUND, mesh)));
    let views = [
        ("front", View::Front, false),
        ("right", View::Right, false),
        ("left", View::Left, false),
        ("top", View::Top, false),
        ("right_transparent", View::Right, true),
        ("left_transparent", View::Left, true),
    ];
    let draw = |(name, view, is_transparent): (&'static str, View, bool)| {
        let props = if is_transparent { &inner } else { &solid };
        Ok((name, picture(patient, props, view, is_transparent)?))
    };
    views.into_iter().map(draw).collect()
}

fn picture(
    patient: &PatientFolder,
    props: &[Prop],
    view: View,
    is_transparent: bool,
) -> Result<Vec<u8>> {
    let [width, height] = SIZE;
    let scene = Scene {
        meshes: props.iter().map(Prop::mesh).collect(),
        background: look::BACKGROUND,
        ..Scene::default()
    };
    let camera = view.of_whole(&patient.surface.bounds(), width as f64 / height as f64);
    let options = Options {
        width,
        height,
        samples: 2,
        is_transparent,
    };
    let mut image = render(&scene, &camera, &options).image;
    let (w, h) = (width as f32, height as f32);
    let letter = h / 42.0;
    let margin = 1.6 * letter;
    let mut canvas = Canvas::new(&mut image);
    // The canvas knows capitals; other letters stay blank.
    let title: String = patient.name.to_uppercase().chars().take(60).collect();
    canvas.text([margin, margin], letter, [235, 238, 242], &title);
    let per_mm = camera.half_heights_per_mm() * 0.5 * h;
    scale_bar(&mut canvas, [margin, h - margin], letter, per_mm);
    let corner = [w - 3.9 * letter - margin, h - 3.9 * letter - margin];
    orientation(&mut canvas, corner, letter, &camera);
    encode_png(&image)
}

fn skin(kind: Kind, material: Material, mesh: &TriMesh) -> Prop {
    let positions: Vec<[f32; 3]> = mesh
        .vertices
        .iter()
        .map(|p| p.cast::<f32>().into())
        .collect();
    Prop {
        kind,
        material,
        rest: vec![],
        normals: vertex_normals(&positions, &mesh.triangles),
        positions,
        triangles: mesh.triangles.clone(),
    }
}
