// From samples to pixels: twin of Job::average in frame.rs.
@group(0) @binding(7) var<storage, read_write> pixels: array<u32>;

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
