//! How much of its surroundings a visible point sees: screen-space ambient occlusion at two scales.
use crate::project::Raster;
use crate::vector::{V3, dot, sub};

/// Radii \[mm\]: a slit's, and a jaw's hollows.
const RADII: [f32; 2] = [3.0, 13.0];
const TAPS: usize = 9;
/// Nothing is looked up farther away than so many samples.
const FARTHEST: f32 = 120.0;

/// Neighbouring samples look in different directions and are averaged into one pixel.
const TURNS: usize = 16;

fn tap(turn: usize, k: usize) -> [f32; 2] {
    let angle = k as f32 * 2.399_963 + turn as f32 * 0.39;
    let r = ((k as f32 + 0.5) / TAPS as f32).sqrt();
    [r * angle.cos(), r * angle.sin()]
}

/// All taps of all turns, for ambient occlusion elsewhere.
#[cfg(feature = "gpu")]
pub fn turned_taps() -> Vec<[f32; 2]> {
    (0..TURNS)
        .flat_map(|turn| (0..TAPS).map(move |k| tap(turn, k)))
        .collect()
}

/// Depths, zero where nothing is, with unit normals.
pub struct Seen<'a> {
    raster: &'a Raster,
    depths: &'a [f32],
    normals: &'a [V3],
    /// Directions of the taps in units of the reach, for each turn.
    taps: Vec<[[f32; 2]; TAPS]>,
}

impl<'a> Seen<'a> {
    /// Of a frame's first surfaces.
    pub fn new(raster: &'a Raster, depths: &'a [f32], normals: &'a [V3]) -> Self {
        let turn = |turn: usize| std::array::from_fn(|k| tap(turn, k));
        Self {
            raster,
            depths,
            normals,
            taps: (0..TURNS).map(turn).collect(),
        }
    }

    fn position(&self, x: usize, y: usize) -> Option<V3> {
        let depth = self.depths[y * self.raster.width + x];
        (depth > 0.0).then(|| self.raster.ray(x, y).map(|d| d * depth))
    }

    /// 1 in the open, towards 0 deep in a hollow.
    pub fn open(&self, x: usize, y: usize) -> f32 {
        let Some(p) = self.position(x, y) else {
            return 1.0;
        };
        let i = y * self.raster.width + x;
        let mut open = 1.0;
        for radius in RADII {
            let reach = (radius * self.raster.focal() / self.depths[i]).clamp(1.5, FARTHEST);
            let hidden: f32 = self.taps[(x & 3) + 4 * (y & 3)]
                .iter()
                .map(|[u, v]| {
                    let at = [x as f32 + reach * u, y as f32 + reach * v];
                    self.hidden_by(p, self.normals[i], at, radius)
                })
                .sum();
            open *= (1.0 - 1.5 * hidden / TAPS as f32).max(0.0);
        }
        open
    }

    fn hidden_by(&self, p: V3, normal: V3, [x, y]: [f32; 2], radius: f32) -> f32 {
        let (w, h) = (self.raster.width as f32, self.raster.height as f32);
        if !(0.0..w).contains(&x) || !(0.0..h).contains(&y) {
            return 0.0;
        }
        let Some(q) = self.position(x as usize, y as usize) else {
            return 0.0;
        };
        let way = sub(q, p);
        let square = dot(way, way);
        let near = (1.0 - square / (radius * radius)).max(0.0);
        let height = (dot(way, normal) - 0.03 * radius).max(0.0);
        near * height / square.sqrt().max(1e-4)
    }
}
