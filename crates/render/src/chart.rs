//! Line charts, as SVG or as a picture.
use crate::annotate::Canvas;
use crate::frame::Image;
use std::fmt::Write;

/// A line with its name.
#[derive(Clone, Debug)]
pub struct Series {
    name: String,
    points: Vec<(f64, f64)>,
    has_dots: bool,
}

impl Series {
    /// Of at least one point.
    pub fn new(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.to_owned(),
            points,
            has_dots: false,
        }
    }

    /// With a dot at each point.
    pub fn dotted(mut self) -> Self {
        self.has_dots = true;
        self
    }
}

/// A chart of some lines.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    /// Above it.
    pub title: String,
    /// What is told along x and y.
    pub axes: [String; 2],
    /// The lines.
    pub series: Vec<Series>,
    /// Where the y axis begins; without it a little below the lowest point.
    pub floor: Option<f64>,
    /// Whether both axes have the same scale.
    pub is_equal: bool,
    /// Which of the axes are logarithmic; their values must be positive.
    pub is_log: [bool; 2],
    /// Places on the x axis that are marked, and how.
    pub marks: Vec<(f64, String)>,
    /// Whether the names of the lines stand at the lower right, not at the upper one.
    pub is_named_low: bool,
}

const SIZE: [f64; 2] = [640.0, 360.0];
const MARGIN: [f64; 2] = [70.0, 50.0];
const COLOURS: [[u8; 3]; 8] = [
    [0x1b, 0x6c, 0xa8],
    [0xd1, 0x49, 0x5b],
    [0x2e, 0x8b, 0x57],
    [0x8e, 0x6b, 0xb0],
    [0xc7, 0x7d, 0x0a],
    [0x4d, 0x90, 0x8e],
    [0x55, 0x55, 0x55],
    [0x9a, 0x3f, 0x8a],
];
const BLACK: [u8; 3] = [0; 3];
const GRID: [u8; 3] = [0xdd; 3];
const MARK: [u8; 3] = [0x99; 3];

/// Pixels a unit of the chart.
const RESOLUTION: f32 = 2.0;

/// What a chart is made of, in units of [`SIZE`].
enum Shape {
    Lines {
        points: Vec<[f64; 2]>,
        width: f64,
        colour: [u8; 3],
    },
    Text {
        at: [f64; 2],
        /// Of the text's length that lies left of `at`.
        share_left: f64,
        size: f64,
        colour: [u8; 3],
        is_upright: bool,
        text: String,
    },
}

impl Chart {
    /// As SVG.
    pub fn svg(&self) -> String {
        let [w, h] = SIZE;
        let mut s = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" font-family=\"sans-serif\" font-size=\"12\">\n\
             <rect width=\"{w}\" height=\"{h}\" fill=\"white\"/>\n"
        );
        for shape in self.shapes() {
            shape.write_svg(&mut s);
        }
        s + "</svg>\n"
    }

    /// As a picture, in capital letters.
    pub fn image(&self) -> Image {
        let [width, height] = SIZE.map(|v| (v as f32 * RESOLUTION) as usize);
        let mut image = Image {
            width,
            height,
            pixels: vec![[255; 4]; width * height],
        };
        let mut canvas = Canvas::new(&mut image);
        self.shapes().iter().for_each(|s| s.draw(&mut canvas));
        image
    }

    fn shapes(&self) -> Vec<Shape> {
        let ranges = self.ranges();
        let at = |p: (f64, f64)| self.place(p, ranges);
        let mut shapes = self.grid(ranges);
        for (x, what) in &self.marks {
            let [px, _] = at((*x, ranges[1][0]));
            let points = vec![[px, MARGIN[1]], [px, SIZE[1] - MARGIN[1]]];
            shapes.push(Shape::Lines {
                points,
                width: 1.0,
                colour: MARK,
            });
            shapes.push(text([px, MARGIN[1] - 5.0], 0.5, what));
        }
        let room = 14.0 * (self.series.len() as f64 + 1.0);
        let legend = if self.is_named_low {
            SIZE[1] - MARGIN[1] - room
        } else {
            MARGIN[1]
        };
        for (k, series) in self.series.iter().enumerate() {
            let colour = COLOURS[k % COLOURS.len()];
            let points: Vec<[f64; 2]> = series.points.iter().map(|p| at(*p)).collect();
            if series.has_dots {
                let dot = |p: &[f64; 2]| Shape::Lines {
                    points: vec![[p[0] - 0.01, p[1]], *p],
                    width: 6.0,
                    colour,
                };
                shapes.extend(points.iter().map(dot));
            }
            shapes.push(Shape::Lines {
                points,
                width: if series.points.len() > 400 { 1.2 } else { 2.0 },
                colour,
            });
            shapes.push(Shape::Text {
                at: [SIZE[0] - 40.0, legend + 14.0 * (k as f64 + 1.0)],
                share_left: 1.0,
                size: 12.0,
                colour,
                is_upright: false,
                text: series.name.clone(),
            });
        }
        shapes
    }

    /// Title, grid, axes.
    fn grid(&self, ranges: [[f64; 2]; 2]) -> Vec<Shape> {
        let [w, h] = SIZE;
        let mut shapes = vec![Shape::Text {
            at: [0.5 * w, 24.0],
            share_left: 0.5,
            size: 15.0,
            colour: BLACK,
            is_upright: false,
            text: self.title.clone(),
        }];
        let [left, bottom] = self.place((ranges[0][0], ranges[1][0]), ranges);
        let [right, top] = self.place((ranges[0][1], ranges[1][1]), ranges);
        let line = |points| Shape::Lines {
            points,
            width: 1.0,
            colour: GRID,
        };
        for v in ticks(ranges[0], self.is_log[0]) {
            let [x, _] = self.place((v, ranges[1][0]), ranges);
            shapes.push(line(vec![[x, bottom], [x, top]]));
            shapes.push(text([x, bottom + 16.0], 0.5, &short(v)));
        }
        for v in ticks(ranges[1], self.is_log[1]) {
            let [_, y] = self.place((ranges[0][0], v), ranges);
            shapes.push(line(vec![[left, y], [right, y]]));
            shapes.push(text([left - 6.0, y + 4.0], 1.0, &short(v)));
        }
        shapes.push(text([0.5 * w, h - 10.0], 0.5, &self.axes[0]));
        shapes.push(Shape::Text {
            at: [16.0, 0.5 * h],
            share_left: 0.5,
            size: 12.0,
            colour: BLACK,
            is_upright: true,
            text: self.axes[1].clone(),
        });
        shapes
    }

    fn place(&self, (px, py): (f64, f64), [x, y]: [[f64; 2]; 2]) -> [f64; 2] {
        let share = |v: f64, r: [f64; 2], is_log: bool| {
            if is_log {
                (v / r[0]).ln() / (r[1] / r[0]).ln()
            } else {
                (v - r[0]) / (r[1] - r[0])
            }
        };
        let [along, up] = [share(px, x, self.is_log[0]), share(py, y, self.is_log[1])];
        [
            MARGIN[0] + along * (SIZE[0] - 1.5 * MARGIN[0]),
            SIZE[1] - MARGIN[1] - up * (SIZE[1] - 2.0 * MARGIN[1]),
        ]
    }

    fn ranges(&self) -> [[f64; 2]; 2] {
        let points = || self.series.iter().flat_map(|s| &s.points);
        let wide = |values: &mut dyn Iterator<Item = f64>, is_log: bool| {
            let [lo, hi] = values.fold([f64::INFINITY, f64::NEG_INFINITY], |r, v| {
                [r[0].min(v), r[1].max(v)]
            });
            if is_log {
                return [lo / 1.3, hi * 1.3];
            }
            let room = (0.06 * (hi - lo)).max(1e-9 + 1e-3 * hi.abs());
            [lo - room, hi + room]
        };
        let mut x = wide(&mut points().map(|p| p.0), self.is_log[0]);
        let mut y = wide(&mut points().map(|p| p.1), self.is_log[1]);
        if let Some(floor) = self.floor {
            y[0] = floor;
        }
        if self.is_equal {
            let [w, h] = [SIZE[0] - 1.5 * MARGIN[0], SIZE[1] - 2.0 * MARGIN[1]];
            let scale = ((x[1] - x[0]) / w).max((y[1] - y[0]) / h);
            for (r, pixels) in [(&mut x, w), (&mut y, h)] {
                let middle = 0.5 * (r[0] + r[1]);
                *r = [middle - 0.5 * scale * pixels, middle + 0.5 * scale * pixels];
            }
        }
        [x, y]
    }
}

/// Four to ten round numbers of a range; of a logarithmic one 1, 2 and 5 of each decade, or 1 alone where that is many.
fn ticks(range: [f64; 2], is_log: bool) -> Vec<f64> {
    let [lo, hi] = range;
    let all: Vec<f64> = if is_log {
        let steps: &[f64] = if hi > 3e2 * lo {
            &[1.0]
        } else {
            &[1.0, 2.0, 5.0]
        };
        let decades = lo.log10().floor() as i32..=hi.log10().ceil() as i32;
        decades
            .flat_map(|d| steps.iter().map(move |s| s * 10f64.powi(d)))
            .collect()
    } else {
        let decade = 10f64.powf(((hi - lo) / 4.0).log10().floor());
        let step = [5.0, 2.0, 1.0].map(|s| s * decade);
        let step = step.into_iter().find(|s| *s <= (hi - lo) / 4.0);
        let step = step.unwrap_or(decade);
        let first = (lo / step).ceil() as i64;
        let last = (hi / step).floor() as i64;
        (first..=last).map(|k| k as f64 * step).collect()
    };
    all.into_iter().filter(|v| (lo..=hi).contains(v)).collect()
}

fn text(at: [f64; 2], share_left: f64, words: &str) -> Shape {
    Shape::Text {
        at,
        share_left,
        size: 12.0,
        colour: BLACK,
        is_upright: false,
        text: words.to_owned(),
    }
}

impl Shape {
    fn write_svg(&self, out: &mut String) {
        match self {
            Self::Lines {
                points,
                width,
                colour,
            } => {
                let at = |p: &[f64; 2]| format!("{:.1},{:.1}", p[0], p[1]);
                let points: Vec<String> = points.iter().map(at).collect();
                let _ = writeln!(
                    out,
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\" stroke-linecap=\"round\"/>",
                    points.join(" "),
                    hex(*colour)
                );
            }
            Self::Text {
                at: [x, y],
                share_left,
                size,
                colour,
                is_upright,
                text,
            } => {
                let anchor = ["start", "middle", "end"][(2.0 * share_left) as usize];
                let place = if *is_upright {
                    format!("transform=\"translate({x:.1} {y:.1}) rotate(-90)\"")
                } else {
                    format!("x=\"{x:.1}\" y=\"{y:.1}\"")
                };
                let text = text.replace('&', "&amp;").replace('<', "&lt;");
                let _ = writeln!(
                    out,
                    "<text {place} text-anchor=\"{anchor}\" font-size=\"{size}\" fill=\"{}\">{text}</text>",
                    hex(*colour)
                );
            }
        }
    }

    fn draw(&self, canvas: &mut Canvas) {
        let pixel = |p: &[f64; 2]| p.map(|v| v as f32 * RESOLUTION);
        match self {
            Self::Lines {
                points,
                width,
                colour,
            } => {
                for pair in points.windows(2) {
                    let width = *width as f32 * RESOLUTION;
                    canvas.line(pixel(&pair[0]), pixel(&pair[1]), width, *colour);
                }
            }
            Self::Text {
                at,
                share_left,
                size,
                colour,
                is_upright,
                text,
            } => {
                // Capitals of the usual fonts are .7 of their size; strokes are wide, so a little less.
                let height = 0.6 * *size as f32 * RESOLUTION;
                let text = text.to_uppercase();
                let left = *share_left as f32 * Canvas::text_width(height, &text);
                let [x, y] = pixel(at);
                if *is_upright {
                    canvas.upright_text([x - height, y + left], height, *colour, &text);
                } else {
                    canvas.plain_text([x - left, y - height], height, *colour, &text);
                }
            }
        }
    }
}

fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Three significant digits.
fn short(v: f64) -> String {
    let digits = (2.0 - v.abs().max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{v:.digits$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(is_log: [bool; 2]) -> Chart {
        Chart {
            title: "Times < budget".into(),
            axes: ["nodes".into(), "ms".into()],
            series: vec![Series::new("ours", vec![(600.0, 1.0), (60_000.0, 100.0)]).dotted()],
            is_log,
            ..Chart::default()
        }
    }

    #[test]
    fn powers_are_straight_lines_on_logarithmic_axes() {
        let c = chart([true; 2]);
        let r = c.ranges();
        let [a, m, b] = [(600.0, 1.0), (6000.0, 10.0), (60_000.0, 100.0)].map(|p| c.place(p, r));
        for k in 0..2 {
            assert!((m[k] - 0.5 * (a[k] + b[k])).abs() < 1e-9);
        }
        assert_eq!(ticks([0.9, 11.0], true), [1.0, 2.0, 5.0, 10.0]);
        assert_eq!(ticks([0.9, 1100.0], true), [1.0, 10.0, 100.0, 1000.0]);
        assert_eq!(ticks([-0.3, 9.9], false), [0.0, 2.0, 4.0, 6.0, 8.0]);
    }

    #[test]
    fn both_forms_show_the_line() {
        let c = chart([false; 2]);
        assert!(c.svg().contains("Times &lt; budget"));
        let [x, y] = c.place((30_300.0, 50.5), c.ranges());
        let image = c.image();
        let at = |p: [f64; 2]| {
            let [x, y] = p.map(|v| (v as f32 * RESOLUTION) as usize);
            image.pixels[y * image.width + x]
        };
        assert_eq!(at([x, y])[..3], COLOURS[0]);
        assert_eq!(at([x, y + 40.0])[..3], [255; 3]);
    }
}
