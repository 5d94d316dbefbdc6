// Light on surfaces: twin of shade.rs.
@group(0) @binding(2) var<storage, read> meshes: array<Mesh>;
// Unit normal and position before deformation of each vertex.
@group(0) @binding(4) var<storage, read> attributes: array<f32>;
// For each sample: facing and number of the triangle seen first, and its depth's bits; no depth where nothing is.
@group(0) @binding(5) var<storage, read_write> hits: array<vec2<u32>>;

struct Surface {
    normal: vec3<f32>,
    position: vec3<f32>,
    rest: vec3<f32>,
    mesh: u32,
}

const PLAIN: u32 = 0u;
const CORTICAL: u32 = 1u;
const SAWN: u32 = 2u;
const BROKEN: u32 = 3u;
const STEEL: u32 = 4u;
const SIGNAL: u32 = 5u;

fn normal_of(v: u32) -> vec3<f32> {
    return vec3<f32>(attributes[6u * v], attributes[6u * v + 1u], attributes[6u * v + 2u]);
}

fn rest_of(v: u32) -> vec3<f32> {
    return vec3<f32>(attributes[6u * v + 3u], attributes[6u * v + 4u], attributes[6u * v + 5u]);
}

fn unit(v: vec3<f32>) -> vec3<f32> {
    return v * (1.0 / max(length(v), 1e-20));
}

// What a sample's ray meets of a triangle at a depth; `info` as in a fragment.
fn surface_at(info: u32, at: vec2<u32>, depth: f32) -> Surface {
    let t = triangles[info & TRIANGLE];
    let flags = meshes[t.w].flags;
    let position = frame.eye + ray(at) * depth;
    let a = position_of(t.x);
    let u = position_of(t.y) - a;
    let v = position_of(t.z) - a;
    let d = position - a;
    let n = cross(u, v);
    let square = max(dot(n, n), 1e-30);
    let wb = dot(cross(d, v), n) / square;
    let wc = dot(cross(u, d), n) / square;
    var w = clamp(vec3<f32>(1.0 - wb - wc, wb, wc), vec3<f32>(0.0), vec3<f32>(1.0));
    w *= 1.0 / max(w.x + w.y + w.z, 1e-6);
    var normal = unit(n);
    if (flags & SMOOTH) != 0u {
        normal = unit(w.x * normal_of(t.x) + w.y * normal_of(t.y) + w.z * normal_of(t.z));
    }
    var rest = position;
    if (flags & HAS_REST) != 0u {
        rest = w.x * rest_of(t.x) + w.y * rest_of(t.y) + w.z * rest_of(t.z);
    }
    // By facing, not by the sign of the product with the ray: that rings at silhouettes.
    return Surface(select(normal, -normal, (info & IS_BACK) != 0u), position, rest, t.w);
}

// A fixed pseudo-random number, -1 to 1, for each point of the lattice.
fn hashed(p: vec3<i32>) -> f32 {
    let q = bitcast<vec3<u32>>(p);
    var h = (q.x * 0x8da6b343u) ^ (q.y * 0xd8163841u) ^ (q.z * 0xcb1ab31fu);
    h = (h ^ (h >> 15u)) * 0x2c1b3c6du;
    h = (h ^ (h >> 12u)) * 0x297a2d39u;
    return f32(h >> 8u) / 8388608.0 - 1.0;
}

// Smooth value noise, -1 to 1.
fn noise(p: vec3<f32>) -> f32 {
    let cell = floor(p);
    let t = p - cell;
    let f = t * t * (3.0 - 2.0 * t);
    let c = vec3<i32>(cell);
    let low = vec4<f32>(
        hashed(c), hashed(c + vec3<i32>(0, 1, 0)), hashed(c + vec3<i32>(0, 0, 1)), hashed(c + vec3<i32>(0, 1, 1)),
    );
    let d = c + vec3<i32>(1, 0, 0);
    let high = vec4<f32>(
        hashed(d), hashed(d + vec3<i32>(0, 1, 0)), hashed(d + vec3<i32>(0, 0, 1)), hashed(d + vec3<i32>(0, 1, 1)),
    );
    let x = mix(low, high, f.x);
    let y = mix(x.xz, x.yw, f.y);
    return mix(y.x, y.y, f.z);
}

fn smooth_step(low: f32, high: f32, v: f32) -> f32 {
    let t = clamp((v - low) / (high - low), 0.0, 1.0);
    return t * t * (3.0 - 2.0 * t);
}

// A normal tilted by the slope of a noise.
fn bumped(n: vec3<f32>, p: vec3<f32>, frequency: f32, strength: f32, towards: vec3<f32>) -> vec3<f32> {
    const STEP = 0.25;
    let q = p * frequency;
    let here = noise(q);
    let aside = vec3<f32>(
        noise(q + vec3<f32>(STEP, 0.0, 0.0)),
        noise(q + vec3<f32>(0.0, STEP, 0.0)),
        noise(q + vec3<f32>(0.0, 0.0, STEP)),
    );
    let tilted = unit(n - strength * (aside - here) / STEP);
    // A visible point's normal never looks away from the eye.
    let facing = dot(tilted, towards);
    if facing > 0.02 {
        return tilted;
    }
    return unit(tilted + towards * (0.02 - facing));
}

struct Textured {
    albedo: vec3<f32>,
    normal: vec3<f32>,
}

fn textured(s: Surface, towards: vec3<f32>) -> Textured {
    let color = meshes[s.mesh].color;
    let p = s.rest;
    switch meshes[s.mesh].texture {
        case CORTICAL: {
            let mottled = 1.0 + 0.05 * noise(p * 0.35) + 0.04 * noise(p * 1.7);
            return Textured(color * mottled, bumped(s.normal, p, 2.2, 0.035, towards));
        }
        case SAWN: {
            let scores = noise(p * vec3<f32>(0.4, 0.4, 5.0));
            return Textured(color * (1.0 + 0.10 * scores), bumped(s.normal, p, 3.5, 0.05, towards));
        }
        case BROKEN: {
            let pores = smooth_step(0.10, 0.55, noise(p * 1.35));
            let coarse = bumped(s.normal, p, 0.8, 0.45, towards);
            let dark = (1.0 - 0.42 * pores) * (1.0 + 0.12 * noise(p * 0.5));
            return Textured(color * dark, bumped(coarse, p, 2.3, 0.30, towards));
        }
        case STEEL: {
            let brushed = noise(p * vec3<f32>(1.2, 9.0, 9.0));
            return Textured(color * (1.0 + 0.03 * brushed), s.normal);
        }
        default: {
            return Textured(color, s.normal);
        }
    }
}

// Light of the three lamps on a surface, and their highlight.
struct Lit {
    diffuse: vec3<f32>,
    highlight: vec3<f32>,
}

// Fixed to the eye: direction (right, up, towards the eye), colour.
fn lamp(
    lit: Lit, direction: vec3<f32>, color: vec3<f32>, normal: vec3<f32>, towards: vec3<f32>, gloss: f32, reached: f32,
) -> Lit {
    let d = unit(direction);
    let to_light = d.x * frame.right + d.y * frame.up - d.z * frame.forward;
    let cosine = max(dot(normal, to_light), 0.0) * reached;
    let sharpness = 8.0 + 120.0 * gloss * gloss;
    let half = unit(to_light + towards);
    let peak = pow(max(dot(normal, half), 0.0), sharpness);
    let strength = gloss * (0.15 + 0.02 * sharpness) * peak * reached;
    return Lit(lit.diffuse + color * (0.60 * cosine), lit.highlight + color * (strength * sqrt(cosine)));
}

// Colour that reaches the eye, linear.
fn shade(s: Surface, open: f32, is_detailed: bool) -> vec3<f32> {
    let m = meshes[s.mesh];
    let towards = unit(frame.eye - s.position);
    var look = Textured(m.color, s.normal);
    if is_detailed {
        look = textured(s, towards);
    }
    let normal = look.normal;
    if m.texture == SIGNAL {
        let facing = 0.55 + 0.45 * abs(dot(normal, towards));
        return look.albedo * (facing * (0.6 + 0.4 * open));
    }
    let up = 0.5 + 0.5 * normal.z;
    let ambient = vec3<f32>(0.50, 0.54, 0.60) * up + vec3<f32>(0.24, 0.20, 0.18) * (1.0 - up);
    // What is deep in a slit sees little of the lights either.
    let reached = 0.35 + 0.65 * open;
    var lit = Lit(ambient * open, vec3<f32>(0.0));
    lit = lamp(lit, vec3<f32>(-0.45, 0.65, 0.62), vec3<f32>(1.45, 1.41, 1.33), normal, towards, m.gloss, reached);
    lit = lamp(lit, vec3<f32>(0.85, -0.05, 0.50), vec3<f32>(0.34, 0.38, 0.46), normal, towards, m.gloss, reached);
    lit = lamp(lit, vec3<f32>(0.30, 0.75, -0.60), vec3<f32>(0.50, 0.52, 0.56), normal, towards, m.gloss, reached);
    var seen = look.albedo * lit.diffuse;
    if m.texture == STEEL {
        seen = seen * 0.35 + steel_mirror(normal, towards, look.albedo, open);
    }
    return haze(seen + lit.highlight, s.position);
}

fn steel_mirror(normal: vec3<f32>, towards: vec3<f32>, albedo: vec3<f32>, open: f32) -> vec3<f32> {
    let h = 2.0 * dot(normal, towards) * normal.z - towards.z;
    let bright = 0.16 + 0.85 * smooth_step(0.0, 0.7, h) + 0.22 * smooth_step(0.1, 0.9, -h);
    return albedo * (bright * (0.3 + 0.7 * open) * 0.75);
}

fn haze(color: vec3<f32>, position: vec3<f32>) -> vec3<f32> {
    let depth = dot(frame.forward, position - frame.eye);
    let share = 0.38 * clamp((depth - frame.distance) / 90.0, 0.0, 1.0);
    return color * (1.0 - share) + vec3<f32>(0.045, 0.058, 0.075) * share;
}

// Opacity in a transparent frame.
fn opacity(s: Surface) -> f32 {
    let o = meshes[s.mesh].opacity;
    if o >= 1.0 {
        return 1.0;
    }
    let towards = frame.eye - s.position;
    let facing = abs(dot(s.normal, towards)) / max(length(towards), 1e-6);
    let side = 1.0 - facing;
    return min(o + max(0.85 - o, 0.0) * 0.8 * side * side * side, 1.0);
}
