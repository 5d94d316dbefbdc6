// Samples of a transparent frame to pixels.
@group(0) @binding(6) var<storage, read> colors: array<vec4<f32>>;

@compute @workgroup_size(8, 8)
fn average(@builtin(global_invocation_id) id: vec3<u32>) {
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
