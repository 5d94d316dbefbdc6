//! What is seen of solids with known equations, pixel by pixel, drawn on the processor.
mod solids;

use osteotome_render::{Options, render};
use solids::Case;

fn check(case: &Case) {
    let scene = case.scene();
    case.check(&render(&scene, &case.camera, &case.options(false)));
    let small = Options {
        width: 320,
        height: 180,
        ..case.options(false)
    };
    let once = render(&scene, &case.camera, &small);
    for _ in 0..10 {
        let again = render(&scene, &case.camera, &small);
        assert!(again == once, "{}: a repeat differs", case.name);
    }
}

#[test]
fn sphere_minus_prism() {
    check(&solids::sphere_minus_prism());
}

#[test]
fn nested_shells() {
    check(&solids::nested_shells());
}

#[test]
fn a_bent_crack() {
    check(&solids::bent_crack());
}

#[test]
fn camera_inside_the_bone_and_inside_the_slit() {
    solids::from_inside().iter().for_each(check);
}
