// Samples to pixels: twin of Job::shade_first and Job::average in frame.rs, and of ambient.rs.
@group(0) @binding(7) var<storage, read_write> pixels: array<u32>;
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
    let depth = bitcast<f32>(hits[q.y * frame.size.x + q.x].y);
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

fn to_srgb(c: vec3<f32>) -> u32 {
    let v = clamp(c, vec3<f32>(0.0), vec3<f32>(1.0));
    let high = 1.055 * pow(v, vec3<f32>(1.0 / 2.4)) - 0.055;
    let s = vec3<u32>(floor(255.0 * select(high, 12.92 * v, v <= vec3<f32>(0.0031308)) + 0.5));
    return s.x | (s.y << 8u) | (s.z << 16u) | 0xff000000u;
}

fn behind_all(y: u32) -> vec3<f32> {
    let down = (f32(y) + 0.5) / f32(frame.size.y / frame.samples);
    return frame.top * (1.0 - down) + frame.bottom * down;
}

// Sample k of a pixel.
fn sample_at(pixel: vec2<u32>, k: u32) -> vec2<u32> {
    return pixel * frame.samples + vec2<u32>(k % frame.samples, k / frame.samples);
}

fn seen(color: vec3<f32>) -> vec3<f32> {
    // Averaged as displayed: a bright highlight must not spread over the pixel.
    return clamp(color, vec3<f32>(0.0), vec3<f32>(1.0));
}

@compute @workgroup_size(8, 8)
fn transparent(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = frame.size / frame.samples;
    if id.x >= size.x || id.y >= size.y {
        return;
    }
    let behind = behind_all(id.y);
    let n = frame.samples * frame.samples;
    var sum = vec3<f32>(0.0);
    for (var k = 0u; k < n; k++) {
        let at = sample_at(id.xy, k);
        let color = colors[at.y * frame.size.x + at.x];
        sum += seen(color.xyz + behind * color.w);
    }
    pixels[id.y * size.x + id.x] = to_srgb(sum / f32(n));
}

@compute @workgroup_size(8, 8)
fn opaque(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = frame.size / frame.samples;
    if id.x >= size.x || id.y >= size.y {
        return;
    }
    let n = frame.samples * frame.samples;
    // Samples that see the same surface are shaded once, at the first of them.
    var first: array<u32, MOST_SAMPLES>;
    var sum = vec3<f32>(0.0);
    for (var k = 0u; k < n; k++) {
        let at = sample_at(id.xy, k);
        let i = at.y * frame.size.x + at.x;
        first[k] = k;
        if hits[i].x == 0u {
            sum += seen(behind_all(id.y));
            continue;
        }
        for (var j = 0u; j < k; j++) {
            if first[j] == j && is_same(sample_at(id.xy, j), i) {
                first[k] = j;
                break;
            }
        }
    }
    for (var k = 0u; k < n; k++) {
        let at = sample_at(id.xy, k);
        let i = at.y * frame.size.x + at.x;
        let hit = hits[i];
        if first[k] != k || hit.x == 0u {
            continue;
        }
        var open = 0.0;
        var members = 0.0;
        for (var j = k; j < n; j++) {
            if first[j] == k {
                let other = sample_at(id.xy, j);
                let o = other.y * frame.size.x + other.x;
                open += open_at(other, bitcast<f32>(hits[o].y), colors[o].xyz);
                members += 1.0;
            }
        }
        var s = surface_at(hit.x - 1u, at, bitcast<f32>(hit.y));
        // The facing is in the normal found.
        s.normal = colors[i].xyz;
        sum += members * seen(shade(s, open / members, true));
    }
    pixels[id.y * size.x + id.x] = to_srgb(sum / f32(n));
}

fn is_same(leader: vec2<u32>, i: u32) -> bool {
    let l = leader.y * frame.size.x + leader.x;
    let a = hits[l];
    let b = hits[i];
    if a.x == 0u {
        return false;
    }
    let depth = bitcast<f32>(a.y);
    return triangles[a.x - 1u].w == triangles[b.x - 1u].w
        && dot(colors[l].xyz, colors[i].xyz) > 0.97
        && abs(depth - bitcast<f32>(b.y)) < 0.005 * depth;
}
