//! How long a frame takes: a sphere minus a prism at 960x540, against the triangles, on a graphics device and on the processor.
//!
//! Each A-buffer is held against a plain z-buffer of the same triangles, without any CSG, on the same device in the same run.
//! Run with `cargo bench -p osteotome-render --bench frame`.
#![allow(clippy::print_stdout)]
use osteotome_render::skin::{Anchor, MovedCell, Part, Skin};
use osteotome_render::{
    Camera, Frame, Kind, Material, Mesh, Options, Scene, Texture, render, z_buffer,
};
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
    // Each pole is one vertex, so that the surface is closed.
    let at = |i: u32, k: u32| match i {
        0 => 0,
        _ if i == rings => rings * meridians,
        _ => i * meridians + k % meridians,
    };
    for i in 0..rings {
        for k in 0..meridians {
            let [a, b, c, d] = [at(i, k), at(i + 1, k), at(i + 1, k + 1), at(i, k + 1)];
            let both = [[a, b, c], [a, c, d]];
            triangles.extend(
                both.into_iter()
                    .filter(|[a, b, c]| a != b && b != c && c != a),
            );
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

/// Milliseconds of several things that are done in turn, round by round, so that whatever else the machine does meets all alike.
fn in_turn<const N: usize>(mut once: impl FnMut(usize) -> f64) -> Vec<[f64; N]> {
    let start = Instant::now();
    let mut rounds = Vec::new();
    while rounds.len() < 9 || (rounds.len() < 40 && start.elapsed().as_secs_f64() < 5.0) {
        rounds.push(std::array::from_fn(&mut once));
    }
    rounds
}

/// The least, and the median.
fn summary(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    [values[0], values[values.len() / 2]]
}

/// One thing's times.
fn print(what: &str, rounds: Vec<[f64; 1]>) {
    let [least, median] = summary(rounds.into_iter().flatten().collect());
    println!("    {what}: {least:.3} ms (median {median:.3})");
}

/// An A-buffer beside a z-buffer; the ratio is the median of the rounds' own.
fn compare(what: &str, rounds: &[[f64; 2]]) {
    let of = |k: usize| summary(rounds.iter().map(|r| r[k]).collect());
    let ([z, z_median], [a, a_median]) = (of(0), of(1));
    let ratio = summary(rounds.iter().map(|[z, a]| a / z).collect())[1];
    println!(
        "    {what}: z-buffer {z:.1} ms (median {z_median:.1}), A-buffer {a:.1} ({a_median:.1}), {ratio:.2} times"
    );
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
    let time = |draw: fn(&Scene, &Camera, &Options) -> Frame, is_transparent: bool| {
        let start = Instant::now();
        std::hint::black_box(draw(scene, camera, &options(is_transparent)));
        start.elapsed().as_secs_f64() * 1e3
    };
    println!("  processor");
    let both = [z_buffer, render];
    compare("frame", &in_turn(|k| time(both[k], false)));
    print("transparent frame", in_turn(|_| time(render, true)));
}

#[cfg(feature = "gpu")]
fn on_device(scene: &Scene, camera: &Camera) {
    use osteotome_render::gpu::{Gpu, Work};
    let mut gpu = match Gpu::open(false) {
        Ok(gpu) => gpu,
        Err(fault) => return println!("  {fault}"),
    };
    println!("  {}", gpu.name());
    let yardstick = gpu.yardstick();
    let mut time = |work, is_transparent| {
        let made = gpu.timed(&yardstick, work, scene, camera, &options(is_transparent));
        made.expect("a frame of this size fits").0
    };
    print(
        "update, without waiting for the device",
        in_turn(|_| time(Work::Update, false)),
    );
    let both = [Work::Plain, Work::Lists];
    compare("no light", &in_turn(|k| time(both[k], false)));
    let both = [Work::PlainFrame, Work::Frame];
    compare("frame", &in_turn(|k| time(both[k], false)));
    print("transparent frame", in_turn(|_| time(Work::Frame, true)));
}

/// The cells of a simulation mesh of usual size, each a tetrahedron about the whole sphere.
const N_CELLS: u32 = 4000;
const LOW: f32 = -20.0;
const HIGH: f32 = 75.0;

/// The bone as what moves with cells; here all of them stand still.
fn skin((positions, triangles): &Triangles) -> (Skin, Vec<MovedCell>) {
    let anchor = |(v, p): (u32, &[f32; 3])| {
        let [x, y, z] = p.map(|c| (c - LOW) / (HIGH - LOW));
        Anchor {
            cell: v.wrapping_mul(2_654_435_761) % N_CELLS,
            weights: [1.0 - x - y - z, x, y, z],
            wear: None,
        }
    };
    let part = Part {
        kind: Kind::Bone,
        material: MATERIAL,
        is_smooth: true,
        triangles: triangles.clone(),
    };
    let anchors = (0u32..).zip(positions).map(anchor).collect();
    let cell = [
        [LOW; 3],
        [HIGH, LOW, LOW],
        [LOW, HIGH, LOW],
        [LOW, LOW, HIGH],
    ];
    let skin = Skin::new(anchors, positions.clone(), vec![part]);
    (skin, vec![cell; N_CELLS as usize])
}

fn main() {
    let slit = prism([-3.0, -21.0, 2.0], [3.0, 21.0, 21.0]);
    let camera = Camera::look_at([17.0, -52.0, 41.0], [0.0; 3], [0.0, 0.0, 1.0], 40.0);
    for (rings, meridians) in [(80, 128), (160, 256), (320, 512)] {
        let bone = sphere(20.0, rings, meridians);
        let (skin, cells) = skin(&bone);
        println!("{} triangles", bone.1.len() + slit.1.len());
        let slit = Mesh {
            kind: Kind::Kerf,
            material: MATERIAL,
            positions: &slit.0,
            rest: &[],
            normals: &[],
            triangles: &slit.1,
        };
        let scene = Scene {
            skins: &[skin],
            cells: &cells,
            meshes: vec![slit],
            background: [[0.05; 3]; 2],
        };
        on_processor(&scene, &camera);
        #[cfg(feature = "gpu")]
        on_device(&scene, &camera);
    }
}
