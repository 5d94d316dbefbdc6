// Vertices into clip space, once each: twin of project.rs. The near plane clips; there is no far one, and a depth buffer holds
// near / distance, which tells distances apart as finely as numbers do.
@group(0) @binding(1) var<storage, read> positions: array<f32>;
@group(0) @binding(2) var<storage, read_write> clip: array<vec4<f32>>;

@compute @workgroup_size(64)
fn project(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = id.y * groups.x * 64u + id.x;
    if i >= frame.n_vertices {
        return;
    }
    let p = vec3<f32>(positions[3u * i], positions[3u * i + 1u], positions[3u * i + 2u]) - frame.eye;
    let v = vec3<f32>(dot(frame.right, p), dot(frame.up, p), dot(frame.forward, p));
    let aspect = f32(frame.size.y) / f32(frame.size.x);
    clip[i] = vec4<f32>(
        (frame.shift * v.z + v.x / frame.tangent) * aspect,
        v.y / frame.tangent,
        frame.near,
        v.z,
    );
}
