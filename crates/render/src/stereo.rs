//! Two pictures in one.
use crate::frame::Image;

/// How the pictures of both eyes share one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stereo {
    /// The left eye's picture in the left half, both squeezed to half their width.
    SideBySide,
    /// The left eye's picture in the upper half, both squeezed to half their height.
    OverUnder,
    /// Even rows for the left eye, odd rows for the right: polarised monitors.
    Interlaced,
    /// Red for the left eye, green and blue for the right.
    Anaglyph,
}

/// One picture of two of equal size, and of that size.
pub fn compose(left: &Image, right: &Image, stereo: Stereo) -> Image {
    let (w, h) = (left.width, left.height);
    let pixel = |i: usize| {
        let (x, y) = (i % w, i / w);
        match stereo {
            Stereo::SideBySide => {
                let half = w.div_ceil(2);
                let (eye, x) = if x < half {
                    (left, x)
                } else {
                    (right, x - half)
                };
                mean(eye, [2 * x, y], [2 * x + 1, y])
            }
            Stereo::OverUnder => {
                let half = h.div_ceil(2);
                let (eye, y) = if y < half {
                    (left, y)
                } else {
                    (right, y - half)
                };
                mean(eye, [x, 2 * y], [x, 2 * y + 1])
            }
            Stereo::Interlaced => [left, right][y % 2].pixels[i],
            Stereo::Anaglyph => anaglyph(left.pixels[i], right.pixels[i]),
        }
    };
    Image {
        width: w,
        height: h,
        pixels: (0..w * h).map(pixel).collect(),
    }
}

fn mean(image: &Image, a: [usize; 2], b: [usize; 2]) -> [u8; 4] {
    let at = |[x, y]: [usize; 2]| {
        image.pixels[y.min(image.height - 1) * image.width + x.min(image.width - 1)]
    };
    let (a, b) = (at(a), at(b));
    std::array::from_fn(|k| ((u16::from(a[k]) + u16::from(b[k])) / 2) as u8)
}

/// The left eye sees brightness through the red glass, so that red things do not shine into one eye only.
fn anaglyph(left: [u8; 4], right: [u8; 4]) -> [u8; 4] {
    let [r, g, b, _] = left.map(f32::from);
    let bright = 0.30 * r + 0.59 * g + 0.11 * b;
    [bright.round() as u8, right[1], right[2], 255]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, Kind, Material, Mesh, Options, Scene, Texture, render};

    fn plain(color: [u8; 4]) -> Image {
        Image {
            width: 4,
            height: 4,
            pixels: vec![color; 16],
        }
    }

    /// Mean column of what is seen of a square of 2 mm, `ahead` \[mm\] along +y, by an eye `aside`.
    fn column(camera: &Camera, ahead: f32, aside: f32) -> f32 {
        let corner = |x: f32, z: f32| [x, ahead, z];
        let positions = [
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
        ];
        let square = Mesh {
            kind: Kind::Solid,
            material: Material {
                color: [0.5; 3],
                opacity: 1.0,
                gloss: 0.0,
                texture: Texture::Plain,
            },
            positions: &positions,
            rest: &[],
            normals: &[],
            triangles: &[[0, 1, 2], [0, 2, 3]],
        };
        let scene = Scene {
            meshes: vec![square],
            ..Scene::default()
        };
        let options = Options {
            width: 400,
            height: 400,
            samples: 1,
            is_transparent: false,
        };
        let frame = render(&scene, &camera.aside(aside), &options);
        let seen: Vec<usize> = (0..frame.ids.len()).filter(|i| frame.ids[*i] > 0).collect();
        seen.iter().map(|i| (i % 400) as f32).sum::<f32>() / seen.len() as f32
    }

    #[test]
    fn both_eyes_see_at_the_same_place_what_is_where_they_converge() {
        let camera = Camera::look_at([0.0; 3], [0.0, 100.0, 0.0], [0.0, 0.0, 1.0], 30.0);
        let apart = |ahead| column(&camera, ahead, -3.0) - column(&camera, ahead, 3.0);
        assert!(apart(100.0).abs() < 0.6, "{}", apart(100.0));
        // 6 mm apart: nearer things stand out, farther ones lie behind the screen.
        let per_mm = 200.0 / camera.tangent;
        for ahead in [50.0, 200.0] {
            let expected = 6.0 * per_mm * (1.0 / ahead - 0.01);
            let got = apart(ahead);
            assert!((got - expected).abs() < 1.0, "{got} instead of {expected}");
        }
    }

    #[test]
    fn each_eye_has_its_part() {
        let (l, r) = ([200, 0, 0, 255], [0, 100, 50, 255]);
        let made = |s| compose(&plain(l), &plain(r), s).pixels;
        let at = |p: &[[u8; 4]], x: usize, y: usize| p[4 * y + x];
        let p = made(Stereo::SideBySide);
        assert_eq!([at(&p, 1, 3), at(&p, 2, 0)], [l, r]);
        let p = made(Stereo::OverUnder);
        assert_eq!([at(&p, 3, 1), at(&p, 0, 2)], [l, r]);
        let p = made(Stereo::Interlaced);
        assert_eq!([at(&p, 0, 2), at(&p, 0, 3)], [l, r]);
        assert_eq!(made(Stereo::Anaglyph)[5], [60, 100, 50, 255]);
    }
}
