// From a z-buffer's target to hits, as first.wgsl leaves them.
@group(0) @binding(5) var<storage, read_write> hits: array<vec2<u32>>;
@group(0) @binding(7) var nearest: texture_2d<u32>;

@compute @workgroup_size(8, 8)
fn gather(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < frame.size.x && id.y < frame.size.y {
        hits[id.y * frame.size.x + id.x] = textureLoad(nearest, id.xy, 0).xy;
    }
}
