//! A frame from beginning to end.
use crate::ambient::Seen;
use crate::csg::{Event, walk};
use crate::project::{Raster, ScreenTriangle, TILE, bin, project};
use crate::raster::{Fragment, TileBounds, TileLists, nearest};
use crate::scene::{Camera, Kind, Scene};
use crate::shade::{ahead, opacity, shade, surface_at};
use crate::vector::{V3, add, dot, scale};
use rayon::prelude::*;

/// How a frame is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Samples a pixel in each direction, 1 to 4.
    pub samples: usize,
    /// Whether all layers are blended by their opacity, or only the first is shown.
    pub is_transparent: bool,
}

/// A picture, row by row from the top, sRGB with opaque alpha.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Image {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Red, green, blue, alpha.
    pub pixels: Vec<[u8; 4]>,
}

/// A picture and what each of its samples shows first.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The picture.
    pub image: Image,
    /// For each sample, row by row, the mesh seen first plus one; 0 for none.
    pub ids: Vec<u32>,
    /// Its distance along the camera's axis \[mm\]; 0 for none.
    pub depths: Vec<f32>,
}

/// Less than this shining through is not followed.
const FAINT: f32 = 0.01;
/// Layers that count for less are shaded without their pattern.
const DETAILED: f32 = 0.25;
/// Samples of a pixel at most.
const MOST_SAMPLES: usize = 16;

/// What a sample shows first.
#[derive(Clone, Copy, Default)]
struct Hit {
    depth: f32,
    /// Number of the projected triangle plus one; 0 for none.
    triangle: u32,
}

/// A tile's part of the frame.
struct TilePart {
    bounds: TileBounds,
    hits: Vec<Hit>,
    /// Normals of the hits; in a transparent frame the blended colours and what shines through.
    colors: Vec<([f32; 3], f32)>,
}

/// Makes a frame; the same input gives the same bits for any number of threads.
pub fn render(scene: &Scene, camera: &Camera, options: &Options) -> Frame {
    draw(scene, camera, options, false)
}

/// An opaque frame of all meshes by a plain z-buffer, nothing cut away: what benches hold [`render`] against.
pub fn z_buffer(scene: &Scene, camera: &Camera, options: &Options) -> Frame {
    let options = Options {
        is_transparent: false,
        ..*options
    };
    draw(scene, camera, &options, true)
}

fn draw(scene: &Scene, camera: &Camera, options: &Options, is_plain: bool) -> Frame {
    let moved: Vec<_> = scene.skins.iter().map(|s| s.moved(scene.cells)).collect();
    let of_skins = scene.skins.iter().zip(&moved);
    let mut meshes: Vec<_> = of_skins.flat_map(|(s, moved)| s.meshes(moved)).collect();
    meshes.extend(&scene.meshes);
    let scene = &Scene {
        meshes,
        background: scene.background,
        ..Scene::default()
    };
    let samples = options.samples.clamp(1, 4);
    let raster = Raster {
        camera: *camera,
        width: options.width * samples,
        height: options.height * samples,
    };
    let triangles = project(scene, &raster);
    let bins = bin(&triangles, &raster);
    let job = Job {
        scene,
        raster: &raster,
        triangles: &triangles,
        is_transparent: options.is_transparent,
        is_plain,
    };
    let parts: Vec<TilePart> = bins
        .par_iter()
        .enumerate()
        .map_init(TileLists::default, |lists, (tile, numbers)| {
            job.tile(lists, TileBounds::new(tile, &raster), numbers)
        })
        .collect();
    let n = raster.width * raster.height;
    let mut hits = vec![Hit::default(); n];
    let mut colors = vec![([0.0; 3], 1.0); n];
    for part in parts {
        let across = part.bounds.x[1] - part.bounds.x[0];
        for (row, y) in (part.bounds.y[0]..part.bounds.y[1]).enumerate() {
            let to = y * raster.width + part.bounds.x[0];
            let from = row * across..(row + 1) * across;
            hits[to..to + across].copy_from_slice(&part.hits[from.clone()]);
            colors[to..to + across].copy_from_slice(&part.colors[from]);
        }
    }
    if !options.is_transparent {
        colors = job.shade_first(&hits, &colors, samples);
    }
    let id = |h: &Hit| match h.triangle {
        0 => 0,
        t => triangles[t as usize - 1].mesh + 1,
    };
    Frame {
        image: job.average(&colors, samples),
        ids: hits.iter().map(id).collect(),
        depths: hits.iter().map(|h| h.depth).collect(),
    }
}

struct Job<'a> {
    scene: &'a Scene<'a>,
    raster: &'a Raster,
    triangles: &'a [ScreenTriangle],
    is_transparent: bool,
    /// Whether the nearest surface is seen, whatever it means.
    is_plain: bool,
}

impl Job<'_> {
    fn tile(&self, lists: &mut TileLists, bounds: TileBounds, numbers: &[u32]) -> TilePart {
        let n = (bounds.x[1] - bounds.x[0]) * (bounds.y[1] - bounds.y[0]);
        let mut part = TilePart {
            bounds,
            hits: Vec::with_capacity(n),
            colors: Vec::with_capacity(n),
        };
        let nearest = if self.is_plain {
            nearest(self.triangles, numbers, bounds)
        } else {
            lists.fill(self.triangles, numbers, bounds);
            Vec::new()
        };
        for y in bounds.y[0]..bounds.y[1] {
            for x in bounds.x[0]..bounds.x[1] {
                let place = (y - bounds.y[0]) * TILE + (x - bounds.x[0]);
                let (hit, color) = if self.is_plain {
                    self.first(nearest[place], [x, y])
                } else {
                    self.sample(lists.list(place), [x, y])
                };
                part.hits.push(hit);
                part.colors.push(color);
            }
        }
        part
    }

    /// A fragment with its normal.
    fn first(&self, found: Option<Fragment>, at: [usize; 2]) -> (Hit, (V3, f32)) {
        let Some(f) = found else {
            return (Hit::default(), ([0.0; 3], 1.0));
        };
        let t = &self.triangles[f.triangle as usize];
        let hit = Hit {
            depth: f.depth,
            triangle: f.triangle + 1,
        };
        let normal = surface_at(self.scene, self.raster, t, at, f.depth).normal;
        (hit, (normal, 0.0))
    }

    /// The first visible fragment with its normal, or all of them blended.
    fn sample(&self, list: &[Fragment], at: [usize; 2]) -> (Hit, (V3, f32)) {
        let mut hit = Hit::default();
        let mut color = [0.0; 3];
        let mut through = 1.0;
        let event = |f: &Fragment| {
            let t = &self.triangles[f.triangle as usize];
            Event {
                kind: t.kind,
                is_front: t.is_front,
            }
        };
        let ahead_of = |f: &Fragment, other: &Fragment| {
            let both = [f, other].map(|f| &self.triangles[f.triangle as usize]);
            ahead(self.scene, self.raster, both, at, f.depth)
        };
        walk(list, event, ahead_of, |k| {
            let f = &list[k];
            let t = &self.triangles[f.triangle as usize];
            // What lies within the bone is for transparent bones only.
            if !self.is_transparent && t.kind == Kind::Within {
                return true;
            }
            if hit.triangle == 0 {
                hit = Hit {
                    depth: f.depth,
                    triangle: f.triangle + 1,
                };
            }
            let s = surface_at(self.scene, self.raster, t, at, f.depth);
            if !self.is_transparent {
                color = s.normal;
                return false;
            }
            let share = through * opacity(&s, self.raster);
            let is_detailed = share > DETAILED;
            color = add(
                color,
                scale(shade(&s, self.raster, 1.0, is_detailed), share),
            );
            through -= share;
            through > FAINT
        });
        (hit, (color, through))
    }

    /// Colours of an opaque frame, where `found` holds the normals.
    ///
    /// Samples of a pixel that see the same surface are shaded once, at the first of them.
    fn shade_first(&self, hits: &[Hit], found: &[(V3, f32)], samples: usize) -> Vec<(V3, f32)> {
        let depths: Vec<f32> = hits.iter().map(|h| h.depth).collect();
        let normals: Vec<V3> = found.iter().map(|f| f.0).collect();
        let seen = Seen::new(self.raster, &depths, &normals);
        let width = self.raster.width;
        let across = width / samples;
        let mesh = |i: usize| self.triangles[hits[i].triangle as usize - 1].mesh;
        let is_same = |i: usize, j: usize| {
            mesh(i) == mesh(j)
                && dot(normals[i], normals[j]) > 0.97
                && (depths[i] - depths[j]).abs() < 0.005 * depths[i]
        };
        let pixel = |p: usize| {
            let (px, py) = (p % across * samples, p / across * samples);
            let at = |k: usize| (py + k / samples) * width + px + k % samples;
            let mut groups: Vec<Vec<usize>> = Vec::with_capacity(2);
            for k in (0..samples * samples).filter(|k| hits[at(*k)].triangle > 0) {
                let of = groups.iter_mut().find(|g| is_same(at(g[0]), at(k)));
                match of {
                    Some(group) => group.push(k),
                    None => groups.push(vec![k]),
                }
            }
            let mut colors = [([0.0; 3], 1.0); MOST_SAMPLES];
            for group in &groups {
                let open: f32 = group
                    .iter()
                    .map(|k| seen.open(at(*k) % width, at(*k) / width))
                    .sum();
                let i = at(group[0]);
                let t = &self.triangles[hits[i].triangle as usize - 1];
                let s = surface_at(
                    self.scene,
                    self.raster,
                    t,
                    [i % width, i / width],
                    depths[i],
                );
                let color = shade(&s, self.raster, open / group.len() as f32, true);
                group.iter().for_each(|k| colors[*k] = (color, 0.0));
            }
            colors
        };
        let n = across * (self.raster.height / samples);
        let pixels: Vec<_> = (0..n).into_par_iter().map(pixel).collect();
        let mut colors = vec![([0.0; 3], 1.0); hits.len()];
        for (p, of_pixel) in pixels.iter().enumerate() {
            let (px, py) = (p % across * samples, p / across * samples);
            for (k, color) in of_pixel[..samples * samples].iter().enumerate() {
                colors[(py + k / samples) * width + px + k % samples] = *color;
            }
        }
        colors
    }

    /// Samples over the background, averaged into pixels.
    fn average(&self, colors: &[(V3, f32)], samples: usize) -> Image {
        let (width, height) = (self.raster.width / samples, self.raster.height / samples);
        let [top, bottom] = self.scene.background;
        let pixel = |i: usize| {
            let (x, y) = (i % width, i / width);
            let down = (y as f32 + 0.5) / height as f32;
            let behind = add(scale(top, 1.0 - down), scale(bottom, down));
            let mut sum = [0.0; 3];
            for sy in 0..samples {
                for sx in 0..samples {
                    let at = (y * samples + sy) * self.raster.width + x * samples + sx;
                    let (color, through) = colors[at];
                    let seen = add(color, scale(behind, through));
                    // Averaged as displayed: a bright highlight must not spread over the pixel.
                    sum = add(sum, seen.map(|c| c.clamp(0.0, 1.0)));
                }
            }
            let [r, g, b] = scale(sum, 1.0 / (samples * samples) as f32).map(to_srgb);
            [r, g, b, 255]
        };
        Image {
            width,
            height,
            pixels: (0..width * height).into_par_iter().map(pixel).collect(),
        }
    }
}

/// The sRGB transfer function, 8 bits.
fn to_srgb(c: f32) -> u8 {
    let c = c.clamp(0.0, 1.0);
    let s = if c <= 0.003_130_8 {
        12.92 * c
    } else {
        1.055 * c.powf(1.0 / 2.4) - 0.055
    };
    (255.0 * s).round() as u8
}
