//! Pictures from a graphics device: against rays in closed form, and against the processor's.
#![cfg(feature = "gpu")]
#![allow(clippy::print_stderr)] // a skipped test says so
mod solids;

use osteotome_render::gpu::{Fault, Gpu};
use osteotome_render::skin::{Anchor, MovedCell, Part, Skin, Wear};
use osteotome_render::{Camera, Frame, Kind, Material, Mesh, Options, Scene, Texture, render};
use solids::Case;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

/// One device for all tests that leave it as it is: a software driver takes seconds to compile the shaders.
fn shared() -> Option<MutexGuard<'static, Gpu>> {
    static SHARED: OnceLock<Option<Mutex<Gpu>>> = OnceLock::new();
    let gpu = SHARED.get_or_init(|| gpu().map(Mutex::new)).as_ref()?;
    Some(gpu.lock().unwrap_or_else(PoisonError::into_inner))
}

/// `None`, and a line that says so, where there is no driver (Debian: mesa-vulkan-drivers, libvulkan1).
fn gpu() -> Option<Gpu> {
    match Gpu::open(false) {
        Ok(gpu) => Some(gpu),
        Err(Fault::NoDevice) => {
            eprintln!(
                "SKIPPED: no Vulkan driver, so pictures from a graphics device were not tested"
            );
            None
        }
        Err(fault) => panic!("{fault}"),
    }
}

/// Share of samples that show another mesh, or the same elsewhere.
fn difference(a: &Frame, b: &Frame) -> f64 {
    let n = a.ids.len();
    assert_eq!(n, b.ids.len());
    let differs = |i: &usize| {
        a.ids[*i] != b.ids[*i] || (a.depths[*i] - b.depths[*i]).abs() > 1e-3 * a.depths[*i].abs()
    };
    (0..n).filter(differs).count() as f64 / n as f64
}

/// Mean difference of two pictures' colours, of 255.
fn mean_color(a: &Frame, b: &Frame) -> f64 {
    let pairs = a
        .image
        .pixels
        .iter()
        .flatten()
        .zip(b.image.pixels.iter().flatten());
    let sum: f64 = pairs.map(|(x, y)| f64::from(x.abs_diff(*y))).sum();
    sum / (4 * a.image.pixels.len()) as f64
}

/// Against rays, against the processor's frame, and against itself.
fn check(cases: &[Case]) {
    let Some(mut gpu) = shared() else { return };
    for case in cases {
        let scene = case.scene();
        let mut look = |options: &Options| gpu.frame(&scene, &case.camera, options).unwrap();
        let compare = |options: &Options, frame: &Frame| {
            is_twin(case.name, frame, &render(&scene, &case.camera, options));
        };
        let opaque = case.options(false);
        let frame = look(&opaque);
        case.check(&frame);
        compare(&opaque, &frame);
        for is_transparent in [false, true] {
            let small = Options {
                width: 240,
                height: 135,
                is_transparent,
                ..opaque
            };
            let once = look(&small);
            compare(&small, &once);
            for _ in 0..10 {
                assert!(look(&small) == once, "{}: a repeat differs", case.name);
            }
        }
    }
}

/// Fewer than .01 % of the samples may differ, and colours on the whole hardly at all.
fn is_twin(name: &str, frame: &Frame, twin: &Frame) {
    let (share, color) = (difference(frame, twin), mean_color(frame, twin));
    assert!(
        share < 1e-4,
        "{name}: {:.4} % of the samples differ from the processor's",
        100.0 * share
    );
    assert!(color < 0.02, "{name}: colours differ by {color} of 255");
}

#[test]
fn sphere_minus_prism() {
    check(&[solids::sphere_minus_prism()]);
}

#[test]
fn nested_shells() {
    check(&[solids::nested_shells()]);
}

#[test]
fn a_bent_crack() {
    check(&[solids::bent_crack()]);
}

#[test]
fn camera_inside_the_bone_and_inside_the_slit() {
    check(&solids::from_inside());
}

#[test]
fn lists_longer_than_what_is_sorted_at_once() {
    let Some(mut gpu) = shared() else { return };
    let case = solids::many_shells();
    for is_transparent in [false, true] {
        let options = Options {
            width: 320,
            height: 180,
            ..case.options(is_transparent)
        };
        let frame = gpu.frame(&case.scene(), &case.camera, &options).unwrap();
        is_twin(
            case.name,
            &frame,
            &render(&case.scene(), &case.camera, &options),
        );
    }
}

/// Whatever room there is at first: the frame is drawn again with more, and where there is no more, in bands.
#[test]
fn too_little_room_changes_nothing() {
    let Some(mut gpu) = gpu() else { return };
    let case = solids::many_shells();
    let options = Options {
        width: 300,
        height: 200,
        ..case.options(false)
    };
    let roomy = gpu.frame(&case.scene(), &case.camera, &options).unwrap();
    for (of_tile, shared, most) in [(1, 1, u32::MAX), (100, 1, 400_000)] {
        gpu.limit(of_tile, shared, most);
        for _ in 0..2 {
            let frame = gpu.frame(&case.scene(), &case.camera, &options).unwrap();
            assert!(frame == roomy, "{of_tile} places a tile, {most} in all");
        }
    }
    gpu.limit(100, 1, 1000);
    let refused = gpu.frame(&case.scene(), &case.camera, &options);
    assert_eq!(refused.unwrap_err(), Fault::TooLarge);
    let wide = Options {
        width: 1 << 20,
        ..options
    };
    let refused = gpu.frame(&case.scene(), &case.camera, &wide);
    assert_eq!(refused.unwrap_err(), Fault::TooLarge);
}

#[test]
fn every_material_with_several_samples_a_pixel() {
    let Some(mut gpu) = shared() else { return };
    let case = solids::sphere_minus_prism();
    for (texture, gloss) in [
        (Texture::Plain, 0.75),
        (Texture::Cortical, 0.28),
        (Texture::Sawn, 0.1),
        (Texture::Broken, 0.05),
        (Texture::Steel, 0.8),
        (Texture::Signal, 0.0),
    ] {
        let scene = case.scene_with(texture, gloss);
        for (samples, is_transparent) in [(2, false), (3, true)] {
            let options = Options {
                width: 160,
                height: 90,
                samples,
                is_transparent,
            };
            let frame = gpu.frame(&scene, &case.camera, &options).unwrap();
            let twin = render(&scene, &case.camera, &options);
            is_twin(&format!("{texture:?}"), &frame, &twin);
        }
    }
}

/// A fixed sequence of numbers, 0 to 1.
struct Numbers(u32);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / 16_777_216.0
    }

    fn point(&mut self) -> [f32; 3] {
        [(); 3].map(|()| 30.0 * self.next() - 15.0)
    }
}

/// Triangles of all kinds anywhere, closed by nothing, some of them pairs that are almost closed gaps.
///
/// Scene 1 has a pair that leaves being closed along a hundred samples, where depths as the device interpolates them took rows of samples
/// for the other; scene 4 one so thin that rounding turns it inside out.
#[test]
fn any_triangles_of_any_kind() {
    let Some(mut gpu) = shared() else { return };
    for seed in [1, 4] {
        check_any_triangles(&mut gpu, seed);
    }
}

fn check_any_triangles(gpu: &mut Gpu, seed: u32) {
    let mut numbers = Numbers(seed);
    let kinds = [
        Kind::Bone,
        Kind::Seam,
        Kind::Kerf,
        Kind::Gap,
        Kind::Within,
        Kind::Solid,
        Kind::KerfSeam,
        Kind::GapSeam,
    ];
    let mut shapes = Vec::new();
    for kind in kinds.into_iter().cycle().take(64) {
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        for _ in 0..5 {
            let corners = [(); 3].map(|()| numbers.point());
            let first = positions.len() as u32;
            positions.extend(corners);
            triangles.push([first, first + 1, first + 2]);
            if kind == Kind::Gap {
                // Some open, some closed.
                let aside = 0.06 * numbers.next();
                positions.extend(corners.map(|[x, y, z]| [x, y + aside, z]));
                triangles.push([first + 3, first + 5, first + 4]);
            }
        }
        shapes.push((kind, positions, triangles));
    }
    let meshes = shapes.iter().map(|(kind, positions, triangles)| Mesh {
        kind: *kind,
        material: Material {
            color: [0.5; 3],
            opacity: 0.2,
            gloss: 0.1,
            texture: Texture::Plain,
        },
        positions,
        rest: &[],
        normals: &[],
        triangles,
    });
    let scene = Scene {
        meshes: meshes.collect(),
        background: [[0.1; 3], [0.3; 3]],
        ..Scene::default()
    };
    for eye in [[2.0, -45.0, 9.0], [1.0, -3.0, 2.0]] {
        let camera = Camera::look_at(eye, [0.0; 3], [0.0, 0.0, 1.0], 50.0);
        for is_transparent in [false, true] {
            let options = Options {
                width: 640,
                height: 360,
                samples: 1,
                is_transparent,
            };
            let frame = gpu.frame(&scene, &camera, &options).unwrap();
            let name = format!("any triangles, scene {seed}");
            is_twin(&name, &frame, &render(&scene, &camera, &options));
        }
    }
}

/// A tetrahedron around everything, moved by `turn` \[rad\] about z and `by` \[mm\].
fn cell(turn: f32, by: [f32; 3]) -> MovedCell {
    AROUND.map(|[x, y, z]| {
        let (s, c) = turn.sin_cos();
        [c * x - s * y + by[0], s * x + c * y + by[1], z + by[2]]
    })
}

const AROUND: [[f32; 3]; 4] = [
    [-60.0, -60.0, -60.0],
    [180.0, -60.0, -60.0],
    [-60.0, 180.0, -60.0],
    [-60.0, -60.0, 180.0],
];

/// Two halves of a sphere, each with its cell, and a wall in each that wears.
fn halves(n: u32) -> Skin {
    let shape = solids::sphere(20.0, n);
    let (mut anchors, mut rest) = (Vec::new(), Vec::new());
    let mut parts = Vec::new();
    let material = |texture| Material {
        color: [0.6, 0.5, 0.4],
        opacity: 0.3,
        gloss: 0.2,
        texture,
    };
    for side in 0..2u32 {
        let first = rest.len() as u32;
        for p in &shape.positions {
            // Shape functions of a corner tetrahedron of 240 mm.
            let [x, y, z] = p.map(|c| (c + 60.0) / 240.0);
            anchors.push(Anchor {
                cell: side,
                weights: [1.0 - x - y - z, x, y, z],
                wear: None,
            });
            rest.push(*p);
        }
        let is_here = |t: &&[u32; 3]| {
            let x: f32 = t.iter().map(|v| shape.positions[*v as usize][0]).sum();
            (x > 0.0) == (side == 1)
        };
        let triangles = shape.triangles.iter().filter(is_here);
        parts.push(Part {
            kind: Kind::Bone,
            material: material(Texture::Cortical),
            is_smooth: true,
            triangles: triangles.map(|t| t.map(|v| v + first)).collect(),
        });
    }
    let first = rest.len() as u32;
    for side in 0..2u32 {
        let into = [[-1.0, 0.0, 0.0], [0.5, 0.0, 0.0]][side as usize];
        for (k, [y, z]) in [[-9.0, -9.0], [9.0, -9.0], [0.0, 9.0]]
            .into_iter()
            .enumerate()
        {
            let [x, y1, z1] = [0.0f32, y, z].map(|c| (c + 60.0) / 240.0);
            anchors.push(Anchor {
                cell: side,
                weights: [1.0 - x - y1 - z1, x, y1, z1],
                wear: Some(Wear {
                    opposite: first + 3 * (1 - side) + k as u32,
                    into,
                }),
            });
            rest.push([0.0, y, z]);
        }
    }
    parts.push(Part {
        kind: Kind::Solid,
        material: material(Texture::Broken),
        is_smooth: false,
        triangles: vec![
            [first, first + 1, first + 2],
            [first + 3, first + 5, first + 4],
        ],
    });
    Skin::new(anchors, rest, parts)
}

#[test]
fn skins_move_with_their_cells_and_stay_on_the_device() {
    let Some(mut gpu) = shared() else { return };
    let camera = Camera::look_at([17.0, -62.0, 41.0], [0.0; 3], [0.0, 0.0, 1.0], 40.0);
    let options = Options {
        width: 320,
        height: 180,
        samples: 1,
        is_transparent: false,
    };
    let skins = [[halves(3)], [halves(2)]];
    let case = solids::many_shells();
    let others = case.scene().meshes;
    let mut seen = Vec::new();
    for (skin, apart, n_others) in [
        (0, 0.0, 0),
        (0, 1.0, 0),
        (0, 5.0, 2),
        (1, 5.0, 1),
        (0, 5.0, 25),
    ] {
        let cells = [
            cell(-0.02 * apart, [-apart, 0.0, 0.5]),
            cell(0.03 * apart, [apart, 1.0, 0.0]),
        ];
        let scene = Scene {
            skins: &skins[skin],
            cells: &cells,
            // Well behind, so that what moves is seen.
            meshes: others[25 - n_others..].to_vec(),
            background: [[0.1; 3]; 2],
        };
        let frame = gpu.frame(&scene, &camera, &options).unwrap();
        is_twin("skins", &frame, &render(&scene, &camera, &options));
        seen.push(frame);
    }
    assert!(difference(&seen[0], &seen[1]) > 0.01, "nothing has moved");
    let parts = |frame: &Frame| (1..=3).all(|id| frame.ids.contains(&id));
    assert!(parts(&seen[1]), "not all parts are seen");
}

/// The same solids as a skin of one cell, out of whose box the eye is: from there only what the crack reaches has lists.
fn as_skin(case: &Case) -> (Skin, MovedCell) {
    let scene = case.scene();
    let points = || scene.meshes.iter().flat_map(|m| m.positions);
    let end = |k: usize, of: fn(f32, f32) -> f32| points().map(|p| p[k]).reduce(of).unwrap();
    let eye = case.camera.eye;
    // A corner on the eye's side, and legs away from it.
    let corner = [0, 1, 2].map(|k| match eye[k] > 0.0 {
        true => end(k, f32::max),
        false => end(k, f32::min),
    });
    let leg = [0, 1, 2].map(|k| {
        3.0 * (end(k, f32::min) + end(k, f32::max) - 2.0 * corner[k]).signum()
            * (end(k, f32::max) - end(k, f32::min))
    });
    assert!(
        (0..3).any(|k| (eye[k] - corner[k]) * leg[k] < -1.0),
        "{}: the eye is not outside",
        case.name
    );
    let mut cell = [corner; 4];
    (0..3).for_each(|k| cell[k + 1][k] += leg[k]);
    let (mut anchors, mut rest, mut parts) = (Vec::new(), Vec::new(), Vec::new());
    for mesh in &scene.meshes {
        let first = rest.len() as u32;
        for p in mesh.positions {
            let [x, y, z] = [0, 1, 2].map(|k| (p[k] - corner[k]) / leg[k]);
            anchors.push(Anchor {
                cell: 0,
                weights: [1.0 - x - y - z, x, y, z],
                wear: None,
            });
            rest.push(*p);
        }
        let numbered = mesh.triangles.iter().map(|t| t.map(|v| v + first));
        parts.push(Part {
            kind: mesh.kind,
            material: mesh.material,
            is_smooth: false,
            triangles: numbered.collect(),
        });
    }
    (Skin::new(anchors, rest, parts), cell)
}

#[test]
fn from_outside_only_the_crack_has_lists() {
    let Some(mut gpu) = shared() else { return };
    for case in [solids::sphere_minus_prism(), solids::bent_crack()] {
        let (skin, cell) = as_skin(&case);
        let scene = Scene {
            skins: &[skin],
            cells: &[cell],
            meshes: vec![],
            ..case.scene()
        };
        let options = case.options(false);
        let frame = gpu.frame(&scene, &case.camera, &options).unwrap();
        case.check(&frame);
        is_twin(case.name, &frame, &render(&scene, &case.camera, &options));
        assert!(gpu.frame(&scene, &case.camera, &options).unwrap() == frame);
        let all = gpu.frame(&case.scene(), &case.camera, &options).unwrap();
        assert!(
            difference(&frame, &all) < 1e-4,
            "{}: lists differ",
            case.name
        );
    }
}
