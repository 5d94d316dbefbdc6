//! What is seen of solids with known equations, pixel by pixel, drawn on the processor.
mod solids;

use osteotome_render::render;
use solids::Case;

fn check(case: &Case) {
    let look = || render(&case.scene(), &case.camera, &case.options(false));
    let frame = look();
    case.check(&frame);
    for _ in 0..10 {
        assert!(look() == frame, "{}: a repeat differs", case.name);
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
