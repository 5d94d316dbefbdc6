// From a z-buffer's target to hits and normals, as resolve.wgsl leaves them.
@group(0) @binding(7) var nearest: texture_2d<u32>;

@compute @workgroup_size(8, 8)
fn gather(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= frame.size.x || id.y >= frame.size.y {
        return;
    }
    let sample = id.y * frame.size.x + id.x;
    let found = textureLoad(nearest, id.xy, 0);
    if found.y == 0u {
        hits[sample] = vec2<u32>(0u);
        colors[sample] = vec4<f32>(0.0, 0.0, 0.0, 1.0);
        return;
    }
    hits[sample] = vec2<u32>((found.x & TRIANGLE) + 1u, found.y);
    let s = surface_at(found.x, id.xy, bitcast<f32>(found.y));
    colors[sample] = vec4<f32>(s.normal, 0.0);
}
