//! How long a frame takes: a sphere minus a prism at 960x540, against the triangles, on a graphics device and on the processor.
//!
//! Each A-buffer is held against a plain z-buffer of the same triangles, without any CSG, on the same device in the same run.
//! Run with `cargo bench -p osteotome-render --bench frame`.
#![allow(clippy::print_stdout)]
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

const MATERIAL: Material = Material {
    color: [0.7, 0.6, 0.45],
    opacity: 0.2,
    gloss: 0.3,
    texture: Texture::Cortical,
};

fn median(mut once: impl FnMut() -> f64) -> f64 {
    once();
    let mut times: Vec<f64> = (0..9).map(|_| once()).collect();
    times.sort_by(f64::total_cmp);
    times[4]
}

fn options(is_transparent: bool) -> Options {
    Options {
        width: 960,
        height: 540,
        samples: 1,
        is_transparent,
    }
}

fn on_processor(scene: &Scene, camera: &Camera) {
    let time = |is_transparent: bool| {
        median(|| {
            let start = Instant::now();
            std::hint::black_box(render(scene, camera, &options(is_transparent)));
            start.elapsed().as_secs_f64() * 1e3
        })
    };
    println!(
        "  processor: opaque {:.1} ms, transparent {:.1} ms",
        time(false),
        time(true)
    );
}

#[cfg(feature = "gpu")]
fn on_device(scene: &Scene, camera: &Camera) {
    use osteotome_render::gpu::{Gpu, Work};
    let mut gpu = match Gpu::open(false) {
        Ok(gpu) => gpu,
        Err(fault) => return println!("  {fault}"),
    };
    let mut yardstick = gpu.yardstick();
    let mut time = |work, is_transparent| {
        let options = options(is_transparent);
        median(|| {
            let made = gpu.timed(&mut yardstick, work, scene, camera, &options);
            made.expect("a frame of this size fits").0
        })
    };
    let [plain, lists] = [Work::Plain, Work::Lists].map(|w| time(w, false));
    println!(
        "  device: z-buffer {plain:.1} ms, A-buffer {lists:.1} ms: {:.1} times",
        lists / plain
    );
    let [plain, frame] = [Work::PlainFrame, Work::Frame].map(|w| time(w, false));
    println!(
        "    with light: {plain:.1} ms, {frame:.1} ms: {:.1} times; transparent {:.1} ms",
        frame / plain,
        time(Work::Frame, true)
    );
    println!("    on {}", gpu.name());
}

fn main() {
    let slit = prism([-3.0, -40.0, 2.0], [3.0, 40.0, 40.0]);
    let camera = Camera::look_at([17.0, -52.0, 41.0], [0.0; 3], [0.0, 0.0, 1.0], 40.0);
    for (rings, meridians) in [(80, 128), (160, 256), (320, 512)] {
        let bone = sphere(20.0, rings, meridians);
        let normals = vertex_normals(&bone.0, &bone.1);
        let mesh = |kind, of: &'static Triangles, normals| Mesh {
            kind,
            material: MATERIAL,
            positions: &of.0,
            rest: &[],
            normals,
            triangles: &of.1,
        };
        println!("{} triangles", bone.1.len() + slit.1.len());
        let (b, s): (&'static Triangles, &'static Triangles) =
            (Box::leak(Box::new(bone)), Box::leak(Box::new(slit.clone())));
        let scene = Scene {
            meshes: vec![mesh(Kind::Bone, b, &normals), mesh(Kind::Kerf, s, &[])],
            background: [[0.05; 3]; 2],
            ..Scene::default()
        };
        on_processor(&scene, &camera);
        #[cfg(feature = "gpu")]
        on_device(&scene, &camera);
    }
}
