// An opaque frame's first surfaces, lit: twin of Job::shade_first in frame.rs, and of ambient.rs.
// Directions of the taps in units of the reach: two taps a vector.
@group(0) @binding(8) var<uniform> taps: array<vec4<f32>, 72>;

const TAPS: u32 = 9u;
const FARTHEST: f32 = 120.0;
const MOST_SAMPLES: u32 = 16u;

fn hidden_by(p: vec3<f32>, normal: vec3<f32>, at: vec2<f32>, radius: f32) -> f32 {
    let size = vec2<f32>(frame.size);
    if at.x < 0.0 || at.y < 0.0 || at.x >= size.x || at.y >= size.y {
        return 0.0;
    }
    let q = vec2<u32>(at);
    let depth = bitcast<f32>(hits[q.y * frame.stride + q.x].y);
    if depth <= 0.0 {
        return 0.0;
    }
    let way = ray(q) * depth - p;
    let square = dot(way, way);
    let near = max(1.0 - square / (radius * radius), 0.0);
    let height = max(dot(way, normal) - 0.03 * radius, 0.0);
    return near * height / max(sqrt(square), 1e-4);
}

// 1 in the open, towards 0 deep in a hollow.
fn open_at(at: vec2<u32>, depth: f32, normal: vec3<f32>) -> f32 {
    let p = ray(at) * depth;
    let turn = ((at.x & 3u) + 4u * (at.y & 3u)) * TAPS;
    var open = 1.0;
    for (var r = 0u; r < 2u; r++) {
        let radius = select(13.0, 3.0, r == 0u);
        let reach = clamp(radius * focal() / depth, 1.5, FARTHEST);
        var hidden = 0.0;
        for (var k = turn; k < turn + TAPS; k++) {
            let two = taps[k / 2u];
            let tap = select(two.zw, two.xy, k % 2u == 0u);
            hidden += hidden_by(p, normal, vec2<f32>(at) + reach * tap, radius);
        }
        open *= max(1.0 - 1.5 * hidden / f32(TAPS), 0.0);
    }
    return open;
}

@compute @workgroup_size(8, 8)
fn light(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = frame.size / frame.samples;
    if id.x >= size.x || id.y >= size.y {
        return;
    }
    let n = frame.samples * frame.samples;
    // Samples that see the same surface are shaded once, at the first of them, by what all of them see of the surroundings.
    var normals: array<vec3<f32>, MOST_SAMPLES>;
    var first: array<u32, MOST_SAMPLES>;
    var open: array<f32, MOST_SAMPLES>;
    var members: array<f32, MOST_SAMPLES>;
    var sum = vec3<f32>(0.0);
    for (var k = 0u; k < n; k++) {
        let at = sample_at(id.xy, k);
        let hit = hits[at.y * frame.stride + at.x];
        members[k] = 0.0;
        if hit.y == 0u {
            sum += seen(behind_all(id.y));
            continue;
        }
        let depth = bitcast<f32>(hit.y);
        normals[k] = surface_at(hit.x, at, depth).normal;
        var of_group = k;
        for (var j = 0u; j < k; j++) {
            if members[j] > 0.0 && dot(normals[j], normals[k]) > 0.97 && is_same(sample_at(id.xy, j), hit) {
                of_group = j;
                break;
            }
        }
        let o = open_at(at, depth, normals[k]);
        open[of_group] = select(open[of_group] + o, o, of_group == k);
        members[of_group] += 1.0;
    }
    for (var k = 0u; k < n; k++) {
        if members[k] == 0.0 {
            continue;
        }
        let at = sample_at(id.xy, k);
        let hit = hits[at.y * frame.stride + at.x];
        let s = surface_at(hit.x, at, bitcast<f32>(hit.y));
        sum += members[k] * seen(shade(s, open[k] / members[k], true));
    }
    pixels[id.y * size.x + id.x] = to_srgb(sum / f32(n));
}

fn is_same(leader: vec2<u32>, hit: vec2<u32>) -> bool {
    let a = hits[leader.y * frame.stride + leader.x];
    let depth = bitcast<f32>(a.y);
    return triangles[a.x & TRIANGLE].w == triangles[hit.x & TRIANGLE].w
        && abs(depth - bitcast<f32>(hit.y)) < 0.005 * depth;
}
