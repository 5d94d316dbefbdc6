// What is near lists. Of the triangles that only count where the crack is, those whose box on the screen touches a tile in which lists have begun.
@group(0) @binding(1) var<storage, read> clip: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> triangles: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> meshes: array<Mesh>;
// As in append.wgsl; where lists have begun a tile's counter is not zero.
@group(0) @binding(6) var<storage, read> counters: array<u32>;
@group(0) @binding(7) var<storage, read_write> chosen: array<u32>;
// Vertices, instances, and where both start.
@group(0) @binding(8) var<storage, read_write> call: array<atomic<u32>, 4>;

// Numbers of the tiles that have lists, and how many.
@group(0) @binding(9) var<storage, read_write> tiles: array<u32>;
@group(0) @binding(10) var<storage, read_write> tile_call: array<atomic<u32>, 4>;

const TILE: u32 = 64u;
const LINE: u32 = 16u;

// In samples of the band.
fn place(c: vec4<f32>) -> vec2<f32> {
    let size = vec2<f32>(frame.size);
    let p = vec2<f32>(0.5 + 0.5 * c.x / c.w, 0.5 - 0.5 * c.y / c.w) * size;
    return vec2<f32>(p.x, p.y - f32(frame.band));
}

fn is_near_lists(t: vec4<u32>) -> bool {
    let a = clip[t.x];
    let b = clip[t.y];
    let c = clip[t.z];
    // What reaches behind the eye has no box.
    if min(a.w, min(b.w, c.w)) <= frame.near {
        return true;
    }
    let p = place(a);
    let q = place(b);
    let r = place(c);
    let low = min(p, min(q, r)) - 1.0;
    let high = max(p, max(q, r)) + 1.0;
    let end = vec2<f32>(f32(frame.size.x), f32(frame.rows));
    if high.x < 0.0 || high.y < 0.0 || low.x >= end.x || low.y >= end.y {
        return false;
    }
    let first = vec2<u32>(max(low, vec2<f32>(0.0))) / TILE;
    let last = vec2<u32>(min(high, end - 1.0)) / TILE;
    let across = (frame.size.x + TILE - 1u) / TILE;
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            if counters[(y * across + x + 1u) * LINE] != 0u {
                return true;
            }
        }
    }
    return false;
}

@compute @workgroup_size(64)
fn choose(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = id.y * groups.x * 64u + id.x;
    if i >= frame.n_triangles {
        return;
    }
    let t = triangles[i];
    let kind = meshes[t.w].kind;
    if (kind == BONE || kind == SOLID) && is_near_lists(t) {
        chosen[atomicAdd(&call[0], 3u) / 3u] = i;
    }
}

@compute @workgroup_size(64)
fn begun_tiles(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = id.y * groups.x * 64u + id.x;
    let n = ((frame.size.x + TILE - 1u) / TILE) * ((frame.rows + TILE - 1u) / TILE);
    if i < n && counters[(i + 1u) * LINE] != 0u {
        tiles[atomicAdd(&tile_call[0], 1u)] = i;
    }
}
