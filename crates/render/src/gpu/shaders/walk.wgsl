// Sorts each sample's list and walks it front to back: twin of csg.rs and of Job::sample in frame.rs.
//
// A software device runs every branch for all lanes, so what opaque frames do not need is not in their way: see first.wgsl,
// and blend.wgsl for transparent frames.
@group(0) @binding(7) var<storage, read> heads: array<u32>;
@group(0) @binding(8) var<storage, read> nodes: array<u32>;

const CLOSED: f32 = 0.03;
const NONE: vec2<u32> = vec2<u32>(0xffffffffu, 0xffffffffu);

// Depth's bits, then kind, facing and triangle: ties always go one way, so pictures repeat.
fn is_before(a: vec2<u32>, b: vec2<u32>) -> bool {
    return a.x < b.x || (a.x == b.x && a.y < b.y);
}

fn kind_of(f: vec2<u32>) -> u32 {
    return f.y >> KIND_AT;
}

fn is_front(f: vec2<u32>) -> bool {
    return (f.y & IS_BACK) == 0u;
}

// The first fragment behind `last` in an unsorted list, among gaps only if so asked.
fn behind(head: u32, last: vec2<u32>, of_gap: bool) -> vec2<u32> {
    var best = NONE;
    for (var at = head; at != 0u; at = nodes[3u * at - 3u]) {
        let f = vec2<u32>(nodes[3u * at - 2u], nodes[3u * at - 1u]);
        if is_before(last, f) && is_before(f, best) && (!of_gap || kind_of(f) == GAP) {
            best = f;
        }
    }
    return best;
}

// Bone, kerf and gap: how often the ray is inside of each once it has gone through.
fn passed(counts: vec3<i32>, kind: u32, is_in: bool) -> vec3<i32> {
    let step = select(-1, 1, is_in);
    let counted = vec3<bool>(kind <= SEAM, kind == KERF || kind == KERF_SEAM, kind == GAP || kind == GAP_SEAM);
    return counts + select(vec3<i32>(0), vec3<i32>(step), counted);
}

fn is_cut(counts: vec3<i32>) -> bool {
    return counts.y > 0 || counts.z > 0;
}

// Whether a surface is seen that leads from some counts to others; of a gap only if it is open.
fn is_seen(kind: u32, before: vec3<i32>, counts: vec3<i32>) -> bool {
    let of_bone = !is_cut(counts) && (before.x > 0) != (counts.x > 0);
    let of_cut = counts.x > 0 && is_cut(before) != is_cut(counts);
    return kind == SOLID || (kind == BONE && of_bone)
        || ((kind == KERF || kind == GAP) && of_cut) || (kind == WITHIN && counts.x > 0);
}

// How far behind one fragment's plane another's is along a sample's ray: twin of the same in shade.rs.
fn ahead(face: vec2<u32>, other: vec2<u32>, at: vec2<u32>) -> f32 {
    let t = triangles[face.y & TRIANGLE];
    let o = triangles[other.y & TRIANGLE];
    let corner = position_of(t.x);
    let first = position_of(o.x);
    let n = cross(position_of(t.y) - corner, position_of(t.z) - corner);
    let m = cross(position_of(o.y) - first, position_of(o.z) - first);
    let way = ray(at);
    var p = (frame.eye - corner) + way * bitcast<f32>(face.x);
    p -= way * (dot(n, p) / dot(n, way));
    return dot(m, (first - corner) - p) / dot(m, way);
}

// Whether `other`, the next face of the crack, is right at this one.
fn is_closed(face: vec2<u32>, other: vec2<u32>, at: vec2<u32>) -> bool {
    return other.x != NONE.x && is_front(other) != is_front(face)
        && abs(ahead(face, other, at)) < CLOSED;
}

