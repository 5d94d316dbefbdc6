//! Lines and letters over a finished picture: scale bar, orientation marker, captions.
use crate::frame::Image;

/// Draws on a picture; coordinates are pixels from its upper left corner, strokes are smooth.
pub struct Canvas<'a> {
    image: &'a mut Image,
}

impl<'a> Canvas<'a> {
    /// Over this picture.
    pub fn new(image: &'a mut Image) -> Self {
        Self { image }
    }

    /// A stroke with round ends.
    pub fn line(&mut self, a: [f32; 2], b: [f32; 2], width: f32, color: [u8; 3]) {
        self.capsule(a, b, 0.5 * width, color);
    }

    /// The same with a dark rim, to be read on any ground.
    pub fn rimmed_line(&mut self, a: [f32; 2], b: [f32; 2], width: f32, color: [u8; 3]) {
        self.line(a, b, width + RIM, DARK);
        self.line(a, b, width, color);
    }

    /// Text in capital letters and figures with its upper left corner at `at`; `height` is that of a capital. Characters that
    /// have no glyph are left blank.
    pub fn text(&mut self, at: [f32; 2], height: f32, color: [u8; 3], text: &str) {
        let width = (0.16 * height).max(1.2);
        // All rims before all strokes: a rim must not cover its neighbour's stroke.
        for (width, color) in [(width + RIM, DARK), (width, color)] {
            for (k, c) in text.chars().enumerate() {
                let left = at[0] + k as f32 * ADVANCE * height;
                for (a, b) in strokes(c) {
                    let place =
                        |[x, y]: [f32; 2]| [left + x * height / 6.0, at[1] + y * height / 6.0];
                    self.line(place(a), place(b), width, color);
                }
            }
        }
    }

    /// The same without a rim, for a light ground.
    pub fn plain_text(&mut self, at: [f32; 2], height: f32, color: [u8; 3], text: &str) {
        let place = |[x, y]: [f32; 2]| [at[0] + x, at[1] + y];
        self.strokes_of(text, height, color, place);
    }

    /// Likewise, to be read from below upwards, with the first letter's upper left corner at `at`.
    pub fn upright_text(&mut self, at: [f32; 2], height: f32, color: [u8; 3], text: &str) {
        let place = |[x, y]: [f32; 2]| [at[0] + y, at[1] - x];
        self.strokes_of(text, height, color, place);
    }

    fn strokes_of(
        &mut self,
        text: &str,
        height: f32,
        color: [u8; 3],
        place: impl Fn([f32; 2]) -> [f32; 2],
    ) {
        let width = (0.13 * height).max(1.2);
        for (k, c) in text.chars().enumerate() {
            let left = k as f32 * ADVANCE * height;
            for (a, b) in strokes(c) {
                let [a, b] = [a, b].map(|p| p.map(|v| v * height / 6.0));
                let [a, b] = [a, b].map(|[x, y]| place([left + x, y]));
                self.line(a, b, width, color);
            }
        }
    }

    /// How wide a text of such height is.
    pub fn text_width(height: f32, text: &str) -> f32 {
        let n = text.chars().count() as f32;
        (n * ADVANCE - (ADVANCE - 4.0 / 6.0)).max(0.0) * height
    }

    fn capsule(&mut self, a: [f32; 2], b: [f32; 2], radius: f32, color: [u8; 3]) {
        let (w, h) = (self.image.width as i64, self.image.height as i64);
        let range = |k: usize, n: i64| {
            let low = (a[k].min(b[k]) - radius - 1.0).floor() as i64;
            let high = (a[k].max(b[k]) + radius + 1.0).ceil() as i64;
            low.clamp(0, n)..high.clamp(0, n)
        };
        for y in range(1, h) {
            for x in range(0, w) {
                let distance = to_segment([x as f32 + 0.5, y as f32 + 0.5], a, b);
                let cover = (radius + 0.5 - distance).clamp(0.0, 1.0);
                let pixel = &mut self.image.pixels[(y * w + x) as usize];
                for k in 0..3 {
                    let (under, over) = (f32::from(pixel[k]), f32::from(color[k]));
                    pixel[k] = (under + cover * (over - under)).round() as u8;
                }
            }
        }
    }
}

const RIM: f32 = 2.6;
const DARK: [u8; 3] = [16, 19, 24];
/// From one letter to the next, in heights of a capital.
const ADVANCE: f32 = 0.95;

fn to_segment(p: [f32; 2], a: [f32; 2], b: [f32; 2]) -> f32 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let square = dx * dx + dy * dy;
    let t = if square > 0.0 {
        (((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (p[0] - a[0] - t * dx).hypot(p[1] - a[1] - t * dy)
}

/// A letter's strokes on a raster 4 wide and 6 high, y downward.
fn strokes(c: char) -> Vec<([f32; 2], [f32; 2])> {
    let lines = glyph(c);
    let point = |s: &str| {
        let mut digits = s.bytes().map(|b| f32::from(b - b'0'));
        [digits.next().unwrap_or(0.0), digits.next().unwrap_or(0.0)]
    };
    let mut found = Vec::new();
    for line in lines.split('|').filter(|l| !l.is_empty()) {
        let points: Vec<_> = line.split(' ').map(point).collect();
        found.extend(points.windows(2).map(|w| (w[0], w[1])));
        if points.len() == 1 {
            found.push((points[0], points[0]));
        }
    }
    found
}

/// Polylines of a glyph, each a list of points "xy".
fn glyph(c: char) -> &'static str {
    match c {
        'A' => "06 20 46|14 34",
        'B' => "06 00 30 41 42 33 03|33 44 45 36 06",
        'C' => "41 30 10 01 05 16 36 45",
        'D' => "00 06 26 44 42 20 00",
        'E' => "40 00 06 46|03 33",
        'F' => "40 00 06|03 33",
        'G' => "41 30 10 01 05 16 36 45 43 23",
        'H' => "00 06|40 46|03 43",
        'I' => "20 26",
        'J' => "40 45 36 16 05",
        'K' => "00 06|40 03 46",
        'L' => "00 06 46",
        'M' => "06 00 23 40 46",
        'N' => "06 00 46 40",
        'O' | '0' => "10 30 41 45 36 16 05 01 10",
        'P' => "06 00 30 41 42 33 03",
        'Q' => "10 30 41 45 36 16 05 01 10|24 46",
        'R' => "06 00 30 41 42 33 03|23 46",
        'S' => "41 30 10 01 02 13 33 44 45 36 16 05",
        'T' => "00 40|20 26",
        'U' => "00 05 16 36 45 40",
        'V' => "00 26 40",
        'W' => "00 16 23 36 40",
        'X' => "00 46|40 06",
        'Y' => "00 23 40|23 26",
        'Z' => "00 40 06 46",
        '1' => "11 20 26",
        '2' => "01 10 30 41 42 06 46",
        '3' => "00 40 23 33 44 45 36 16 05",
        '4' => "36 30 04 44",
        '5' => "40 00 03 33 44 45 36 16 05",
        '6' => "30 10 01 05 16 36 45 44 33 13 04",
        '7' => "00 40 16",
        '8' => "13 02 01 10 30 41 42 33 13 04 05 16 36 45 44 33",
        '9' => "16 36 45 41 30 10 01 02 13 33 42",
        'm' => "02 06|03 12 23 26|23 32 43 46",
        's' => "42 12 03 34 45 36 06",
        '.' => "16",
        ',' => "15 07",
        ':' => "22|25",
        '-' => "03 43",
        '=' => "02 42|04 44",
        '/' => "06 40",
        '(' => "30 12 14 36",
        ')' => "10 32 34 16",
        '%' => "06 40|11|45",
        '+' => "03 43|21 25",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_drawn_where_they_are_asked_for() {
        let mut image = Image {
            width: 80,
            height: 30,
            pixels: vec![[255; 4]; 2400],
        };
        Canvas::new(&mut image).text([10.0, 5.0], 18.0, [255, 0, 0], "LI");
        let red = |x: usize, y: usize| image.pixels[y * 80 + x] == [255, 0, 0, 255];
        assert!(red(10, 14), "the stem of L");
        assert!(!red(16, 10) && !red(70, 14));
        assert!(strokes('~').is_empty());
        assert!(Canvas::text_width(18.0, "LI") < 36.0);
    }
}
