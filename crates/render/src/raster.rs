//! A tile's fragments: all triangles over all its samples, sorted by depth.
use crate::project::{Raster, SUBPIXEL, ScreenTriangle, TILE, edge};

/// Where a triangle covers a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fragment {
    /// Distance along the camera's axis \[mm\].
    pub depth: f32,
    /// Which of the projected triangles.
    pub triangle: u32,
}

/// The fragments of one tile.
#[derive(Default)]
pub struct TileLists {
    found: Vec<(u16, Fragment)>,
    first: Vec<u32>,
    sorted: Vec<Fragment>,
}

/// Samples x0..x1, y0..y1.
#[derive(Clone, Copy)]
pub struct TileBounds {
    pub x: [usize; 2],
    pub y: [usize; 2],
}

impl TileBounds {
    pub fn new(tile: usize, raster: &Raster) -> Self {
        let [across, _] = raster.tiles();
        let (x, y) = (tile % across * TILE, tile / across * TILE);
        Self {
            x: [x, (x + TILE).min(raster.width)],
            y: [y, (y + TILE).min(raster.height)],
        }
    }
}

/// The nearest fragment of each place of a tile, as a z-buffer keeps it.
pub fn nearest(
    triangles: &[ScreenTriangle],
    numbers: &[u32],
    bounds: TileBounds,
) -> Vec<Option<Fragment>> {
    let mut found: Vec<Option<Fragment>> = vec![None; TILE * TILE];
    for &i in numbers {
        cover(&triangles[i as usize], bounds, |place, depth| {
            let seen = &mut found[place as usize];
            if seen.is_none_or(|f| depth < f.depth) {
                let triangle = i;
                *seen = Some(Fragment { depth, triangle });
            }
        });
    }
    found
}

impl TileLists {
    /// Rasterises the triangles with these numbers and sorts what they cover.
    pub fn fill(&mut self, triangles: &[ScreenTriangle], numbers: &[u32], bounds: TileBounds) {
        self.found.clear();
        for &i in numbers {
            cover(&triangles[i as usize], bounds, |place, depth| {
                let triangle = i;
                self.found.push((place, Fragment { depth, triangle }));
            });
        }
        self.group();
        // Ties in depth go by meaning, facing and number, so that pictures repeat.
        let key = |f: &Fragment| {
            let t = &triangles[f.triangle as usize];
            (f.depth.to_bits(), t.kind, !t.is_front, f.triangle)
        };
        for place in 0..TILE * TILE {
            let list = self.first[place] as usize..self.first[place + 1] as usize;
            self.sorted[list].sort_unstable_by_key(key);
        }
    }

    /// The fragments at a place in the tile, front to back.
    pub fn list(&self, place: usize) -> &[Fragment] {
        &self.sorted[self.first[place] as usize..self.first[place + 1] as usize]
    }

    /// Counting sort by place.
    fn group(&mut self) {
        self.first.clear();
        self.first.resize(TILE * TILE + 1, 0);
        for (place, _) in &self.found {
            self.first[*place as usize + 1] += 1;
        }
        for k in 0..TILE * TILE {
            self.first[k + 1] += self.first[k];
        }
        let mut next = self.first.clone();
        let nothing = Fragment {
            depth: 0.0,
            triangle: 0,
        };
        self.sorted.clear();
        self.sorted.resize(self.found.len(), nothing);
        for (place, fragment) in &self.found {
            let at = &mut next[*place as usize];
            self.sorted[*at as usize] = *fragment;
            *at += 1;
        }
    }
}

/// Calls `visit` with place and depth of each sample of the tile whose centre the triangle covers; of two triangles with a
/// common edge exactly one covers a centre on it (top-left rule).
fn cover(t: &ScreenTriangle, bounds: TileBounds, mut visit: impl FnMut(u16, f32)) {
    let range = |k: usize, [low, high]: [usize; 2]| {
        let values = t.corners.map(|c| c[k]);
        let least = values.iter().copied().min().unwrap_or(0);
        let most = values.iter().copied().max().unwrap_or(0);
        let from = (least - SUBPIXEL / 2).div_euclid(SUBPIXEL).max(low as i64);
        let to = (most / SUBPIXEL + 1).min(high as i64);
        (from, to)
    };
    let ((x0, x1), (y0, y1)) = (range(0, bounds.x), range(1, bounds.y));
    if x0 >= x1 || y0 >= y1 {
        return;
    }
    let centre = |x: i64, y: i64| [x, y].map(|v| v * SUBPIXEL + SUBPIXEL / 2);
    let edges = [0, 1, 2].map(|k| {
        let (a, b) = (t.corners[k], t.corners[(k + 1) % 3]);
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let is_top_left = dy < 0 || (dy == 0 && dx > 0);
        let start = edge(a, b, centre(x0, y0)) - i64::from(!is_top_left);
        (start, -dy * SUBPIXEL, dx * SUBPIXEL)
    });
    let [z0, zx, zy] = t.inverse_depth;
    for y in y0..y1 {
        let row = edges.map(|(start, _, down)| start + down * (y - y0));
        for x in x0..x1 {
            let inside = (0..3).all(|k| row[k] + edges[k].1 * (x - x0) >= 0);
            if inside {
                let depth = 1.0 / (z0 + zx * x as f64 + zy * y as f64);
                let place = (y as usize - bounds.y[0]) * TILE + (x as usize - bounds.x[0]);
                visit(place as u16, depth as f32);
            }
        }
    }
}
