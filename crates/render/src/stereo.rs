//! Pictures of two eyes, or of more, in one.
use crate::frame::Image;

/// How the pictures of both eyes, or of several views from left to right, share one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stereo {
    /// Columns, the leftmost view's on the left, each picture squeezed into one.
    SideBySide,
    /// Bands, the leftmost view's above, each picture squeezed into one.
    OverUnder,
    /// Rows in turn: polarised monitors show even ones to the left eye, odd ones to the right.
    Interlaced,
    /// Red for the first eye, green and blue for the last.
    Anaglyph,
}

/// One picture of several of equal size, and of that size; of none, none.
pub fn compose(views: &[Image], stereo: Stereo) -> Image {
    let [Some(first), Some(last)] = [views.first(), views.last()] else {
        return Image::default();
    };
    let (w, h, n) = (first.width, first.height, views.len());
    // The view seen at a place, and the first of the n places that it is squeezed from.
    let place = |x: usize, wide: usize| {
        let view = x * n / wide;
        (view, n * (x - (view * wide).div_ceil(n)))
    };
    let pixel = |i: usize| {
        let (x, y) = (i % w, i / w);
        match stereo {
            Stereo::SideBySide => {
                let (view, from) = place(x, w);
                mean((from..from + n).map(|x| views[view].pixels[y * w + x.min(w - 1)]))
            }
            Stereo::OverUnder => {
                let (view, from) = place(y, h);
                mean((from..from + n).map(|y| views[view].pixels[y.min(h - 1) * w + x]))
            }
            Stereo::Interlaced => views[y % n].pixels[i],
            Stereo::Anaglyph => anaglyph(first.pixels[i], last.pixels[i]),
        }
    };
    Image {
        width: w,
        height: h,
        pixels: (0..w * h).map(pixel).collect(),
    }
}

fn mean(pixels: impl ExactSizeIterator<Item = [u8; 4]>) -> [u8; 4] {
    let n = pixels.len() as u32;
    let mut sums = [0u32; 4];
    for p in pixels {
        (0..4).for_each(|k| sums[k] += u32::from(p[k]));
    }
    sums.map(|sum| (sum / n) as u8)
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
        let made = |s| compose(&[plain(l), plain(r)], s).pixels;
        let at = |p: &[[u8; 4]], x: usize, y: usize| p[4 * y + x];
        let p = made(Stereo::SideBySide);
        assert_eq!([at(&p, 1, 3), at(&p, 2, 0)], [l, r]);
        let p = made(Stereo::OverUnder);
        assert_eq!([at(&p, 3, 1), at(&p, 0, 2)], [l, r]);
        let p = made(Stereo::Interlaced);
        assert_eq!([at(&p, 0, 2), at(&p, 0, 3)], [l, r]);
        assert_eq!(made(Stereo::Anaglyph)[5], [60, 100, 50, 255]);
    }

    #[test]
    fn each_of_four_views_has_its_part() {
        let views: Vec<Image> = (0..4).map(|k| plain([k, 0, 0, 255])).collect();
        let made = |s| {
            let pixels = compose(&views, s).pixels;
            pixels.iter().map(|p| p[0]).collect::<Vec<_>>()
        };
        let row = [0, 1, 2, 3];
        assert_eq!(made(Stereo::SideBySide), [row; 4].concat());
        let bands = row.map(|k| [k; 4]).concat();
        assert_eq!(made(Stereo::OverUnder), bands);
        assert_eq!(made(Stereo::Interlaced), bands);
        // Three views do not divide four columns.
        let three = compose(&views[..3], Stereo::SideBySide).pixels;
        assert_eq!([0, 1, 2, 3].map(|x| three[x][0]), [0, 0, 1, 2]);
    }
}
