// Fragments go into their sample's list: twin of raster.rs. No culling, no depth test.
//
// What the crack does not reach needs no list: lists are begun by kerf, gap and seams, and of bone and all else what is near (see
// choose.wgsl) goes into lists that have begun. Everywhere a plain depth buffer finds the nearest of bone and all else, for samples
// without a list. That holds for a closed bone seen from outside: else all go into lists.
@group(0) @binding(1) var<storage, read> clip: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> triangles: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> meshes: array<Mesh>;
// Number of a list's first fragment plus one.
@group(0) @binding(4) var<storage, read_write> heads: array<atomic<u32>>;
// Next (plus one), depth's bits, kind and facing and triangle.
@group(0) @binding(5) var<storage, read_write> nodes: array<u32>;
// One counter would have all cores wait for each other: each tile has its own, on a cache line of its own, and a share of
// the places; what does not fit there spills into the common ones, whose counter is the first.
@group(0) @binding(6) var<storage, read_write> counters: array<atomic<u32>>;
// Numbers of the triangles that are near lists.
@group(0) @binding(7) var<storage, read> chosen: array<u32>;

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat, either) info: u32,
}

fn corner(number: u32, k: u32) -> Corner {
    let t = triangles[number];
    let v = select(select(t.z, t.y, k == 1u), t.x, k == 0u);
    return Corner(clip[v], (meshes[t.w].kind << KIND_AT) | number);
}

@vertex
fn vertex(@builtin(vertex_index) i: u32) -> Corner {
    return corner(i / 3u, i % 3u);
}

@vertex
fn vertex_chosen(@builtin(vertex_index) i: u32) -> Corner {
    return corner(chosen[i / 3u], i % 3u);
}

const TILE: u32 = 64u;
const LINE: u32 = 16u;

fn append(at: vec2<u32>, distance: f32, info: u32) {
    let tile = (at.y / TILE) * ((frame.size.x + TILE - 1u) / TILE) + at.x / TILE;
    let own = atomicAdd(&counters[(tile + 1u) * LINE], 1u);
    var place = tile * frame.of_tile + own;
    if own >= frame.of_tile {
        place = frame.spill + atomicAdd(&counters[0], 1u);
    }
    // The counter goes on: it says how many places are missing.
    if place < frame.capacity {
        let next = atomicExchange(&heads[at.y * frame.size.x + at.x], place + 1u);
        nodes[3u * place] = next;
        // Bits of a positive number sort as the number does.
        nodes[3u * place + 1u] = bitcast<u32>(distance);
        nodes[3u * place + 2u] = info;
    }
}

// Within the band.
fn place_of(position: vec4<f32>) -> vec2<u32> {
    return vec2<u32>(u32(position.x), u32(position.y) - frame.band);
}

@fragment
fn every(
    @builtin(position) position: vec4<f32>,
    @builtin(front_facing) is_front: bool,
    @location(0) @interpolate(flat, either) info: u32,
) -> @location(0) vec4<f32> {
    append(place_of(position), 1.0 / position.w, info | select(IS_BACK, 0u, is_front));
    return vec4<f32>(0.0);
}

// Goes on with lists that have begun.
@fragment
fn begun(
    @builtin(position) position: vec4<f32>,
    @builtin(front_facing) is_front: bool,
    @location(0) @interpolate(flat, either) info: u32,
) -> @location(0) vec4<f32> {
    let at = place_of(position);
    if atomicLoad(&heads[at.y * frame.size.x + at.x]) != 0u {
        append(at, 1.0 / position.w, info | select(IS_BACK, 0u, is_front));
    }
    return vec4<f32>(0.0);
}

// As hits are kept; it writes nowhere else, so that a device may look at the depth first.
@fragment
fn nearest(
    @builtin(position) position: vec4<f32>,
    @builtin(front_facing) is_front: bool,
    @location(0) @interpolate(flat, either) info: u32,
) -> @location(0) vec2<u32> {
    let hit = vec2<u32>((info & TRIANGLE) | select(IS_BACK, 0u, is_front), bitcast<u32>(1.0 / position.w));
    // A face of the bone seen from behind is an edge that turns away: from outside, it hides nothing.
    return select(vec2<u32>(0u), hit, is_front || info >> KIND_AT != BONE);
}
