// Triangles and where their corners are.
@group(0) @binding(1) var<storage, read> triangles: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> positions: array<f32>;

fn position_of(v: u32) -> vec3<f32> {
    return vec3<f32>(positions[3u * v], positions[3u * v + 1u], positions[3u * v + 2u]);
}
