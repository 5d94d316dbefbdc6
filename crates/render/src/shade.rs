//! Light on surfaces.
use crate::project::{Raster, ScreenTriangle};
use crate::scene::{Material, Scene, Texture, flat_normal};
use crate::vector::{V3, add, cross, dot, length, mix, scale, sub, times, unit};

/// A point of a surface as the eye meets it.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Unit, towards the eye's side.
    pub normal: V3,
    /// Where it is \[mm\].
    pub position: V3,
    /// Where it was before deformation \[mm\].
    pub rest: V3,
    /// How it looks.
    pub material: Material,
}

/// Interpolates what a triangle carries at the point that a sample's ray meets at `depth`.
pub fn surface_at(
    scene: &Scene,
    raster: &Raster,
    t: &ScreenTriangle,
    [x, y]: [usize; 2],
    depth: f32,
) -> Surface {
    let mesh = &scene.meshes[t.mesh as usize];
    let position = add(raster.camera.eye, scale(raster.ray(x, y), depth));
    let vertices = mesh.triangles[t.triangle as usize].map(|v| v as usize);
    let corners = vertices.map(|v| mesh.positions[v]);
    let w = barycentric(corners, position);
    let normal = if mesh.normals.is_empty() {
        flat_normal(corners)
    } else {
        unit(mix(vertices.map(|v| mesh.normals[v]), w))
    };
    let rest = if mesh.rest.is_empty() {
        position
    } else {
        mix(vertices.map(|v| mesh.rest[v]), w)
    };
    Surface {
        // By facing, not by the sign of the product with the ray: that rings at silhouettes.
        normal: if t.is_front {
            normal
        } else {
            scale(normal, -1.0)
        },
        position,
        rest,
        material: mesh.material,
    }
}

/// How far behind the first triangle's plane the second's is along a sample's ray \[mm\], where it meets the first at `depth`, or nearly so.
///
/// From the corners: depths are those of triangles snapped to the raster, and a graphics device's are off by a hundred-thousandth besides.
pub fn ahead(
    scene: &Scene,
    raster: &Raster,
    both: [&ScreenTriangle; 2],
    [x, y]: [usize; 2],
    depth: f32,
) -> f32 {
    let [[a, b, c], [p, q, r]] = both.map(|t| {
        let mesh = &scene.meshes[t.mesh as usize];
        mesh.triangles[t.triangle as usize].map(|v| mesh.positions[v as usize])
    });
    let (n, m) = (cross(sub(b, a), sub(c, a)), cross(sub(q, p), sub(r, p)));
    let way = raster.ray(x, y);
    let near = add(sub(raster.camera.eye, a), scale(way, depth));
    let met = sub(near, scale(way, dot(n, near) / dot(n, way)));
    dot(m, sub(sub(p, a), met)) / dot(m, way)
}

/// Barycentric coordinates of the foot of `p`, kept within the triangle.
fn barycentric([a, b, c]: [V3; 3], p: V3) -> V3 {
    let (u, v, d) = (sub(b, a), sub(c, a), sub(p, a));
    let n = cross(u, v);
    let square = dot(n, n).max(1e-30);
    let wb = dot(cross(d, v), n) / square;
    let wc = dot(cross(u, d), n) / square;
    let w = [1.0 - wb - wc, wb, wc].map(|w| w.clamp(0.0, 1.0));
    scale(w, 1.0 / (w[0] + w[1] + w[2]).max(1e-6))
}

/// Lights, fixed to the eye so that every view is lit alike: (right, up, towards the eye), colour.
const LIGHTS: [(V3, V3); 3] = [
    ([-0.45, 0.65, 0.62], [1.45, 1.41, 1.33]),
    ([0.85, -0.05, 0.50], [0.34, 0.38, 0.46]),
    ([0.30, 0.75, -0.60], [0.50, 0.52, 0.56]),
];
/// Light from above and from below, seen from the patient's head.
const SKY: V3 = [0.50, 0.54, 0.60];
const GROUND: V3 = [0.24, 0.20, 0.18];

/// Colour that reaches the eye, linear RGB. `open`: how much of its surroundings the point sees, 0 to 1; `is_detailed`: whether with
/// the texture's pattern.
pub fn shade(s: &Surface, raster: &Raster, open: f32, is_detailed: bool) -> V3 {
    let camera = &raster.camera;
    let towards = unit(sub(camera.eye, s.position));
    let (albedo, normal) = if is_detailed {
        textured(s, towards)
    } else {
        (s.material.color, s.normal)
    };
    if s.material.texture == Texture::Signal {
        let facing = 0.55 + 0.45 * dot(normal, towards).abs();
        return scale(albedo, facing * (0.6 + 0.4 * open));
    }
    let up = 0.5 + 0.5 * normal[2];
    let ambient = add(scale(SKY, up), scale(GROUND, 1.0 - up));
    let mut diffuse = scale(ambient, open);
    let mut highlight = [0.0; 3];
    let sharpness = 8.0 + 120.0 * s.material.gloss * s.material.gloss;
    // What is deep in a slit sees little of the lights either.
    let reached = 0.35 + 0.65 * open;
    for (direction, color) in LIGHTS {
        let [r, u, t] = unit(direction);
        let [right, up, forward] = camera.axes;
        let to_light: V3 = std::array::from_fn(|k| r * right[k] + u * up[k] - t * forward[k]);
        let lit = dot(normal, to_light).max(0.0) * reached;
        diffuse = add(diffuse, scale(color, 0.60 * lit));
        let half = unit(add(to_light, towards));
        let peak = dot(normal, half).max(0.0).powf(sharpness);
        let strength = s.material.gloss * (0.15 + 0.02 * sharpness) * peak * reached;
        highlight = add(highlight, scale(color, strength * lit.sqrt()));
    }
    let seen = if s.material.texture == Texture::Steel {
        add(
            scale(times(albedo, diffuse), 0.35),
            steel_mirror(normal, towards, albedo, open),
        )
    } else {
        times(albedo, diffuse)
    };
    haze(add(seen, highlight), s, raster)
}

/// What a polished blade mirrors: a bright ceiling, a dark horizon, a dim floor.
fn steel_mirror(normal: V3, towards: V3, albedo: V3, open: f32) -> V3 {
    let away = sub(scale(normal, 2.0 * dot(normal, towards)), towards);
    let h = away[2];
    let ceiling = smooth(0.0, 0.7, h);
    let floor = smooth(0.1, 0.9, -h);
    let bright = 0.16 + 0.85 * ceiling + 0.22 * floor;
    scale(albedo, bright * (0.3 + 0.7 * open) * 0.75)
}

/// What is farther off is paler: at most a third of the way to a dark grey, over a jaw's depth.
fn haze(color: V3, s: &Surface, raster: &Raster) -> V3 {
    const MOST: f32 = 0.38;
    const REACH: f32 = 90.0;
    let depth = dot(raster.camera.axes[2], sub(s.position, raster.camera.eye));
    let share = MOST * ((depth - raster.camera.distance) / REACH).clamp(0.0, 1.0);
    let far = [0.045, 0.058, 0.075];
    add(scale(color, 1.0 - share), scale(far, share))
}

/// Albedo and normal with the texture's pattern.
fn textured(s: &Surface, towards: V3) -> (V3, V3) {
    let (p, color, n) = (s.rest, s.material.color, s.normal);
    match s.material.texture {
        Texture::Plain | Texture::Signal => (color, n),
        Texture::Cortical => {
            let mottled = 1.0 + 0.05 * noise(scale(p, 0.35)) + 0.04 * noise(scale(p, 1.7));
            (scale(color, mottled), bumped(n, p, 2.2, 0.035, towards))
        }
        Texture::Sawn => {
            let scores = noise([p[0] * 0.4, p[1] * 0.4, p[2] * 5.0]);
            (
                scale(color, 1.0 + 0.10 * scores),
                bumped(n, p, 3.5, 0.05, towards),
            )
        }
        Texture::Broken => {
            let pores = smooth(0.10, 0.55, noise(scale(p, 1.35)));
            let coarse = bumped(n, p, 0.8, 0.45, towards);
            let dark = (1.0 - 0.42 * pores) * (1.0 + 0.12 * noise(scale(p, 0.5)));
            (scale(color, dark), bumped(coarse, p, 2.3, 0.30, towards))
        }
        Texture::Steel => {
            let brushed = noise([p[0] * 1.2, p[1] * 9.0, p[2] * 9.0]);
            (scale(color, 1.0 + 0.03 * brushed), n)
        }
    }
}

/// A normal tilted by the slope of a noise with `frequency` \[1/mm\].
fn bumped(n: V3, p: V3, frequency: f32, strength: f32, towards: V3) -> V3 {
    const STEP: f32 = 0.25;
    let q = scale(p, frequency);
    let here = noise(q);
    let slope: V3 = std::array::from_fn(|k| {
        let mut aside = q;
        aside[k] += STEP;
        (noise(aside) - here) / STEP
    });
    let tilted = unit(sub(n, scale(slope, strength)));
    // A visible point's normal never looks away from the eye.
    let facing = dot(tilted, towards);
    if facing > 0.02 {
        tilted
    } else {
        unit(add(tilted, scale(towards, 0.02 - facing)))
    }
}

/// Smooth value noise, -1 to 1.
fn noise(p: V3) -> f32 {
    let cell = p.map(f32::floor);
    let f: V3 = std::array::from_fn(|k| {
        let t = p[k] - cell[k];
        t * t * (3.0 - 2.0 * t)
    });
    let mut sum = 0.0;
    for corner in 0..8u32 {
        let mut weight = 1.0;
        let mut at = [0i32; 3];
        for k in 0..3 {
            let high = corner >> k & 1 == 1;
            weight *= if high { f[k] } else { 1.0 - f[k] };
            at[k] = cell[k] as i32 + i32::from(high);
        }
        sum += weight * hashed(at);
    }
    sum
}

/// A fixed pseudo-random number, -1 to 1, for each point of the lattice.
fn hashed([x, y, z]: [i32; 3]) -> f32 {
    let mut h = (x as u32).wrapping_mul(0x8da6_b343)
        ^ (y as u32).wrapping_mul(0xd816_3841)
        ^ (z as u32).wrapping_mul(0xcb1a_b31f);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    (h >> 8) as f32 / 8_388_608.0 - 1.0
}

fn smooth(low: f32, high: f32, v: f32) -> f32 {
    let t = ((v - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Opacity of a surface in a transparent frame: more where it is seen edge-on, so that outlines stand out.
pub fn opacity(s: &Surface, raster: &Raster) -> f32 {
    let o = s.material.opacity;
    if o >= 1.0 {
        return 1.0;
    }
    let towards = sub(raster.camera.eye, s.position);
    let facing = dot(s.normal, towards).abs() / length(towards).max(1e-6);
    let edge = (1.0 - facing).powi(3);
    (o + (0.85 - o).max(0.0) * 0.8 * edge).min(1.0)
}
