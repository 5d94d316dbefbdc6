//! How long a frame takes on the processor: a sphere minus a prism, 20,480 triangles, opaque and transparent.
use osteotome_render::scene::vertex_normals;
use osteotome_render::{Camera, Kind, Material, Mesh, Options, Scene, Texture, render};
use std::time::Instant;

type Triangles = (Vec<[f32; 3]>, Vec<[u32; 3]>);

/// A sphere of rings and meridians.
fn sphere(radius: f32, rings: u32, meridians: u32) -> Triangles {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for i in 0..=rings {
        let polar = std::f32::consts::PI * i as f32 / rings as f32;
        for k in 0..meridians {
            let angle = std::f32::consts::TAU * k as f32 / meridians as f32;
            let r = radius * polar.sin();
            positions.push([r * angle.cos(), r * angle.sin(), radius * polar.cos()]);
        }
    }
    for i in 0..rings {
        for k in 0..meridians {
            let next = (k + 1) % meridians;
            let [a, b] = [i * meridians + k, i * meridians + next];
            triangles.extend([[a, a + meridians, b + meridians], [a, b + meridians, b]]);
        }
    }
    (positions, triangles)
}

/// A box.
fn prism(low: [f32; 3], high: [f32; 3]) -> Triangles {
    let corner = |i: usize| [0, 1, 2].map(|k| if i >> k & 1 == 1 { high[k] } else { low[k] });
    let faces = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    let two = |f: [u32; 4]| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]];
    (
        (0..8).map(corner).collect(),
        faces.into_iter().flat_map(two).collect(),
    )
}

fn main() {
    let material = Material {
        color: [0.7, 0.6, 0.45],
        opacity: 0.2,
        gloss: 0.3,
        texture: Texture::Cortical,
    };
    let (bone, slit) = (
        sphere(20.0, 80, 128),
        prism([-3.0, -40.0, 2.0], [3.0, 40.0, 40.0]),
    );
    let normals = vertex_normals(&bone.0, &bone.1);
    let mesh = |kind, (positions, triangles): &'static Triangles, normals| Mesh {
        kind,
        material,
        positions,
        rest: &[],
        normals,
        triangles,
    };
    let (bone, slit): (&'static Triangles, &'static Triangles) =
        (Box::leak(Box::new(bone)), Box::leak(Box::new(slit)));
    let scene = Scene {
        meshes: vec![
            mesh(Kind::Bone, bone, &normals),
            mesh(Kind::Kerf, slit, &[]),
        ],
        background: [[0.05; 3]; 2],
    };
    let camera = Camera::look_at([17.0, -52.0, 41.0], [0.0; 3], [0.0, 0.0, 1.0], 40.0);
    for (width, height, samples, is_transparent) in [
        (960, 540, 1, false),
        (960, 540, 1, true),
        (1280, 720, 2, false),
        (1280, 720, 2, true),
        (1920, 1080, 1, false),
    ] {
        let options = Options {
            width,
            height,
            samples,
            is_transparent,
        };
        let mut times: Vec<f64> = (0..9)
            .map(|_| {
                let start = Instant::now();
                std::hint::black_box(render(&scene, &camera, &options));
                start.elapsed().as_secs_f64() * 1e3
            })
            .collect();
        times.sort_by(f64::total_cmp);
        #[expect(clippy::print_stdout, reason = "an example's answer")]
        {
            println!(
                "{width}x{height}, {samples}x{samples} samples, transparent {is_transparent}: {:.0} ms (median of 9)",
                times[4]
            );
        }
    }
}
