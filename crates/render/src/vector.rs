//! Three numbers at a time.
pub type V3 = [f32; 3];

pub fn add(a: V3, b: V3) -> V3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}
pub fn sub(a: V3, b: V3) -> V3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}
pub fn scale(a: V3, s: f32) -> V3 {
    a.map(|x| x * s)
}
pub fn times(a: V3, b: V3) -> V3 {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}
pub fn dot(a: V3, b: V3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
pub fn cross(a: V3, b: V3) -> V3 {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
pub fn length(a: V3) -> f32 {
    dot(a, a).sqrt()
}
/// Unit vector; zero stays zero.
pub fn unit(a: V3) -> V3 {
    scale(a, 1.0 / length(a).max(1e-20))
}
/// Weighted sum of three vectors.
pub fn mix(v: [V3; 3], w: V3) -> V3 {
    add(add(scale(v[0], w[0]), scale(v[1], w[1])), scale(v[2], w[2]))
}
