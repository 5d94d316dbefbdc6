// A z-buffer without any CSG, the yardstick of benches: each sample's nearest triangle and its depth.
@group(0) @binding(1) var<storage, read> clip: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> triangles: array<vec4<u32>>;

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat, either) number: u32,
}

@vertex
fn vertex(@builtin(vertex_index) i: u32) -> Corner {
    let number = i / 3u;
    let t = triangles[number];
    let k = i % 3u;
    let v = select(select(t.z, t.y, k == 1u), t.x, k == 0u);
    return Corner(clip[v], number);
}

@fragment
fn fragment(
    @builtin(position) position: vec4<f32>,
    @builtin(front_facing) is_front: bool,
    @location(0) @interpolate(flat, either) number: u32,
) -> @location(0) vec2<u32> {
    return vec2<u32>(number | select(0x10000000u, 0u, is_front), bitcast<u32>(1.0 / position.w));
}
