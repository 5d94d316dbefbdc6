//! Pictures from a graphics device: against rays in closed form, and against the processor's.
#![cfg(feature = "gpu")]
#![allow(clippy::print_stderr)] // a skipped test says so
mod solids;

use osteotome_render::gpu::{Fault, Gpu};
use osteotome_render::{Frame, render};
use solids::Case;

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

fn check(cases: &[Case]) {
    let Some(mut gpu) = gpu() else { return };
    for case in cases {
        let name = case.name;
        for is_transparent in [false, true] {
            let options = case.options(is_transparent);
            let mut look = || gpu.frame(&case.scene(), &case.camera, &options).unwrap();
            let frame = look();
            if !is_transparent {
                case.check(&frame);
            }
            let twin = render(&case.scene(), &case.camera, &options);
            let share = difference(&frame, &twin);
            let color = mean_color(&frame, &twin);
            eprintln!("{name} {is_transparent} {share} {color}");
            assert!(
                share < 1e-4,
                "{name}: {:.4} % differ from the processor's",
                100.0 * share
            );
            assert!(color < 0.05, "{name}: colours differ by {color} of 255");
            for _ in 0..10 {
                assert!(look() == frame, "{name}: a repeat differs");
            }
        }
    }
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
