//! Triangles of the scene on the raster: clipped at the near plane, snapped to 1/256 pixel, binned into tiles.
use crate::scene::{Camera, Kind, Scene};
use crate::vector::{V3, add, scale, sub};

/// Nothing nearer to the eye is seen \[mm\].
pub const NEAR: f32 = 0.5;
/// Subpixel steps: 8 bits, as on graphics hardware.
pub const SUBPIXEL: i64 = 256;
/// Side of a tile in samples; a sample's place in its tile fits 16 bits.
pub const TILE: usize = 64;

/// A triangle on the raster.
#[derive(Clone, Copy, Debug)]
pub struct ScreenTriangle {
    /// Corners in subpixels, area positive.
    pub corners: [[i64; 2]; 3],
    /// One over depth at sample (0, 0), and its change a sample to the right and down.
    pub inverse_depth: [f64; 3],
    /// Which mesh.
    pub mesh: u32,
    /// Which of its triangles.
    pub triangle: u32,
    /// What it means.
    pub kind: Kind,
    /// Whether its outer side is seen.
    pub is_front: bool,
}

/// The raster that a camera's picture is made on.
#[derive(Clone, Copy, Debug)]
pub struct Raster {
    /// The eye.
    pub camera: Camera,
    /// Samples across.
    pub width: usize,
    /// Samples down.
    pub height: usize,
}

impl Raster {
    /// Centre of a sample in half heights from the middle of the picture.
    fn on_plane(&self, x: f32, y: f32) -> [f32; 2] {
        let half = 0.5 * self.height as f32;
        [(x - 0.5 * self.width as f32) / half, 1.0 - y / half]
    }

    /// Direction, one unit deep, through the centre of a sample.
    pub fn ray(&self, x: usize, y: usize) -> V3 {
        let [px, py] = self.on_plane(x as f32 + 0.5, y as f32 + 0.5);
        self.camera.ray(px, py)
    }

    /// Samples a millimetre spans at depth 1.
    pub fn focal(&self) -> f32 {
        0.5 * self.height as f32 / self.camera.tangent
    }

    fn to_screen(self, v: V3) -> [f64; 2] {
        let half = 0.5 * self.height as f64;
        let f = half / (f64::from(v[2]) * f64::from(self.camera.tangent));
        let shift = half * f64::from(self.camera.shift);
        [
            0.5 * self.width as f64 + shift + f64::from(v[0]) * f,
            half - f64::from(v[1]) * f,
        ]
    }

    /// Tiles across and down.
    pub fn tiles(&self) -> [usize; 2] {
        [self.width.div_ceil(TILE), self.height.div_ceil(TILE)]
    }
}

/// All triangles that may touch the raster.
pub fn project(scene: &Scene, raster: &Raster) -> Vec<ScreenTriangle> {
    let mut out = Vec::new();
    for (mesh, m) in (0u32..).zip(&scene.meshes) {
        let view: Vec<V3> = m
            .positions
            .iter()
            .map(|p| raster.camera.to_view(*p))
            .collect();
        for (triangle, t) in (0u32..).zip(m.triangles) {
            let corners = t.map(|v| view[v as usize]);
            let mut push = |corners: [V3; 3]| {
                let made = screen_triangle(raster, corners).map(|s| ScreenTriangle {
                    mesh,
                    triangle,
                    kind: m.kind,
                    ..s
                });
                out.extend(made);
            };
            clip_near(corners, &mut push);
        }
    }
    out
}

/// Hands on the part of a triangle beyond the near plane. A cut edge is always cut from its far end, so that both its
/// triangles get the same corner.
fn clip_near(corners: [V3; 3], push: &mut impl FnMut([V3; 3])) {
    let is_far = |v: &V3| v[2] > NEAR;
    let n_far = corners.iter().filter(|v| is_far(v)).count();
    let cut = |far: V3, near: V3| {
        let s = (far[2] - NEAR) / (far[2] - near[2]);
        let mut p = add(far, scale(sub(near, far), s));
        p[2] = NEAR;
        p
    };
    let turned = |alone: bool| {
        let k = corners.iter().position(|v| is_far(v) == alone).unwrap_or(0);
        [corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]]
    };
    match n_far {
        3 => push(corners),
        2 => {
            let [near, a, b] = turned(false);
            let (p, q) = (cut(a, near), cut(b, near));
            push([p, a, b]);
            push([p, b, q]);
        }
        1 => {
            let [far, a, b] = turned(true);
            push([far, cut(far, a), cut(far, b)]);
        }
        _ => {}
    }
}

fn screen_triangle(raster: &Raster, view: [V3; 3]) -> Option<ScreenTriangle> {
    let on_screen = view.map(|v| raster.to_screen(v));
    let mut corners = on_screen.map(|p| p.map(|c| (c * SUBPIXEL as f64).round() as i64));
    let low = |k: usize| corners.iter().map(|c| c[k]).min().unwrap_or(0);
    let high = |k: usize| corners.iter().map(|c| c[k]).max().unwrap_or(0);
    let (w, h) = (raster.width as i64, raster.height as i64);
    if high(0) < 0 || high(1) < 0 || low(0) > w * SUBPIXEL || low(1) > h * SUBPIXEL {
        return None;
    }
    let [a, b, c] = corners;
    let area = edge(a, b, c);
    if area == 0 {
        return None;
    }
    let inverse_depth = plane(&corners, &view.map(|v| 1.0 / f64::from(v[2])), area);
    // With y downward, counter-clockwise triangles have negative area.
    let is_front = area < 0;
    if is_front {
        corners.swap(1, 2);
    }
    Some(ScreenTriangle {
        corners,
        inverse_depth,
        mesh: 0,
        triangle: 0,
        kind: Kind::Solid,
        is_front,
    })
}

/// Twice the signed area of a, b, c.
pub fn edge(a: [i64; 2], b: [i64; 2], c: [i64; 2]) -> i64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// The linear function with `values` at the corners: at sample (0, 0)'s centre, and its changes a sample.
fn plane(corners: &[[i64; 2]; 3], values: &[f64; 3], area: i64) -> [f64; 3] {
    let [a, b, c] = corners.map(|p| p.map(|v| v as f64 / SUBPIXEL as f64));
    let area = area as f64 / (SUBPIXEL * SUBPIXEL) as f64;
    let (db, dc) = (values[1] - values[0], values[2] - values[0]);
    let dx = (db * (c[1] - a[1]) - dc * (b[1] - a[1])) / area;
    let dy = (dc * (b[0] - a[0]) - db * (c[0] - a[0])) / area;
    [values[0] + dx * (0.5 - a[0]) + dy * (0.5 - a[1]), dx, dy]
}

/// For each tile, row by row, the triangles whose box touches it, ascending.
pub fn bin(triangles: &[ScreenTriangle], raster: &Raster) -> Vec<Vec<u32>> {
    let [across, down] = raster.tiles();
    let mut bins = vec![Vec::new(); across * down];
    let size = TILE as i64 * SUBPIXEL;
    let tile = |v: i64, n: usize| (v.div_euclid(size)).clamp(0, n as i64 - 1) as usize;
    for (i, t) in (0u32..).zip(triangles) {
        let range = |k: usize, n: usize| {
            let values = t.corners.map(|c| c[k]);
            let low = values.iter().copied().min().unwrap_or(0);
            let high = values.iter().copied().max().unwrap_or(0);
            tile(low, n)..=tile(high, n)
        };
        for y in range(1, down) {
            for x in range(0, across) {
                bins[y * across + x].push(i);
            }
        }
    }
    bins
}
