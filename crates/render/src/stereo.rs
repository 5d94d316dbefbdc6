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

    fn plain(color: [u8; 4]) -> Image {
        Image {
            width: 4,
            height: 4,
            pixels: vec![color; 16],
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
