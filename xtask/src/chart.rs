//! Line charts as SVG.
use std::fmt::Write;

/// A line with its name.
pub struct Series {
    name: String,
    points: Vec<(f64, f64)>,
}

impl Series {
    /// Of at least one point.
    pub fn new(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.to_owned(),
            points,
        }
    }
}

/// A chart of some lines.
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
}

const SIZE: [f64; 2] = [640.0, 360.0];
const MARGIN: [f64; 2] = [70.0, 50.0];
const COLOURS: [&str; 7] = [
    "#1b6ca8", "#d1495b", "#2e8b57", "#8e6bb0", "#c77d0a", "#4d908e", "#555555",
];

impl Chart {
    /// The picture.
    pub fn svg(&self) -> String {
        let (x, y) = self.ranges();
        let at = |p: &(f64, f64)| {
            let share = |v: f64, r: [f64; 2]| (v - r[0]) / (r[1] - r[0]);
            (
                MARGIN[0] + share(p.0, x) * (SIZE[0] - 1.5 * MARGIN[0]),
                SIZE[1] - MARGIN[1] - share(p.1, y) * (SIZE[1] - 2.0 * MARGIN[1]),
            )
        };
        let [w, h] = SIZE;
        let mut s = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" font-family=\"sans-serif\" font-size=\"12\">\n\
             <rect width=\"{w}\" height=\"{h}\" fill=\"white\"/>\n\
             <text x=\"{:.1}\" y=\"24\" text-anchor=\"middle\" font-size=\"15\">{}</text>\n",
            0.5 * w,
            self.title
        );
        for k in 0..=4 {
            let share = f64::from(k) / 4.0;
            let (vx, vy) = (x[0] + share * (x[1] - x[0]), y[0] + share * (y[1] - y[0]));
            let (px, bottom) = at(&(vx, y[0]));
            let (left, py) = at(&(x[0], vy));
            let (right, top) = at(&(x[1], y[1]));
            let _ = writeln!(
                s,
                "<path d=\"M{px:.1} {bottom:.1}V{top:.1}M{left:.1} {py:.1}H{right:.1}\" stroke=\"#dddddd\"/>\
                 <text x=\"{px:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                bottom + 16.0,
                short(vx),
                left - 6.0,
                py + 4.0,
                short(vy)
            );
        }
        let _ = writeln!(
            s,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\
             <text transform=\"translate(16 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            0.5 * w,
            h - 10.0,
            self.axes[0],
            0.5 * h,
            self.axes[1]
        );
        // Lines over a floor run high, others anywhere.
        let room = 14.0 * (self.series.len() as f64 + 1.0);
        let legend = match self.floor {
            Some(_) => h - MARGIN[1] - room,
            None => MARGIN[1],
        };
        for (k, series) in self.series.iter().enumerate() {
            let colour = COLOURS[k % COLOURS.len()];
            let path: Vec<String> = series
                .points
                .iter()
                .map(at)
                .map(|(x, y)| format!("{x:.1},{y:.1}"))
                .collect();
            let _ = writeln!(
                s,
                "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" fill=\"{colour}\" text-anchor=\"end\">{}</text>",
                path.join(" "),
                w - 40.0,
                legend + 14.0 * (k as f64 + 1.0),
                series.name
            );
        }
        s + "</svg>\n"
    }

    fn ranges(&self) -> ([f64; 2], [f64; 2]) {
        let points = || self.series.iter().flat_map(|s| &s.points);
        let wide = |values: &mut dyn Iterator<Item = f64>| {
            let [lo, hi] = values.fold([f64::INFINITY, f64::NEG_INFINITY], |r, v| {
                [r[0].min(v), r[1].max(v)]
            });
            let room = (0.06 * (hi - lo)).max(1e-9 + 1e-3 * hi.abs());
            [lo - room, hi + room]
        };
        let mut x = wide(&mut points().map(|p| p.0));
        let mut y = wide(&mut points().map(|p| p.1));
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
        (x, y)
    }
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
