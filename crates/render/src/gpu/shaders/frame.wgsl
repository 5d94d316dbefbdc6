// What all passes know of a frame: `Uniforms` in frame.rs; twin of Raster and Camera.
struct Frame {
    eye: vec3<f32>,
    tangent: f32,
    right: vec3<f32>,
    shift: f32,
    up: vec3<f32>,
    distance: f32,
    forward: vec3<f32>,
    near: f32,
    // Background.
    top: vec3<f32>,
    n_vertices: u32,
    bottom: vec3<f32>,
    is_transparent: u32,
    // In samples.
    size: vec2<u32>,
    // A pixel has samples x samples.
    samples: u32,
    // First row of the band whose lists are kept, and its rows.
    band: u32,
    rows: u32,
    // Places for fragments of each tile, where the common ones start, and of all.
    of_tile: u32,
    spill: u32,
    capacity: u32,
    // Vertices that move with cells come first.
    n_anchored: u32,
    n_triangles: u32,
    // From a row of hits to the next.
    stride: u32,
    unused: u32,
}

// Material and meaning of a mesh.
struct Mesh {
    color: vec3<f32>,
    opacity: f32,
    gloss: f32,
    texture: u32,
    kind: u32,
    flags: u32,
}

const SMOOTH: u32 = 1u;
const HAS_REST: u32 = 2u;

// Order as in scene.rs: ties in depth go by it.
const BONE: u32 = 0u;
const SEAM: u32 = 1u;
const KERF: u32 = 2u;
const GAP: u32 = 3u;
const WITHIN: u32 = 4u;
const SOLID: u32 = 5u;
const KERF_SEAM: u32 = 6u;
const GAP_SEAM: u32 = 7u;

// A fragment's second word: kind, facing, triangle.
const KIND_AT: u32 = 29u;
const IS_BACK: u32 = 0x10000000u;
const TRIANGLE: u32 = 0x0fffffffu;

@group(0) @binding(0) var<uniform> frame: Frame;

// Direction, one unit deep, through the centre of a sample.
fn ray(at: vec2<u32>) -> vec3<f32> {
    let half = 0.5 * f32(frame.size.y);
    let x = (f32(at.x) + 0.5 - 0.5 * f32(frame.size.x)) / half;
    let y = 1.0 - (f32(at.y) + 0.5) / half;
    let s = vec2<f32>((x - frame.shift) * frame.tangent, y * frame.tangent);
    return frame.forward + s.x * frame.right + s.y * frame.up;
}

fn focal() -> f32 {
    return 0.5 * f32(frame.size.y) / frame.tangent;
}
