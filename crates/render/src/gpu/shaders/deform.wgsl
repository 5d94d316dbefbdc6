// Skins' vertices from the moved cells, and their normals: twin of skin.rs and of vertex_normals in scene.rs.
struct Anchor {
    weights: vec4<f32>,
    into: vec3<f32>,
    cell: u32,
    // Itself where nothing wears.
    opposite: u32,
    // Its triangles in `incident`, for the normal.
    first: u32,
    n: u32,
    unused: u32,
}

@group(0) @binding(1) var<storage, read_write> positions: array<f32>;
@group(0) @binding(2) var<storage, read> anchors: array<Anchor>;
// Twelve numbers a cell: its moved nodes, D_T of the paper's equation 7.
@group(0) @binding(3) var<storage, read> cells: array<f32>;
@group(0) @binding(4) var<storage, read_write> attributes: array<f32>;
@group(0) @binding(5) var<storage, read> triangles: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read> incident: array<u32>;

const CRUMBS: f32 = 0.4;
const WORN: f32 = 2.0;

fn carried(v: u32) -> vec3<f32> {
    let a = anchors[v];
    let at = 12u * a.cell;
    var p = vec3<f32>(0.0);
    for (var k = 0u; k < 4u; k++) {
        let node = at + 3u * k;
        p += vec3<f32>(cells[node], cells[node + 1u], cells[node + 2u]) * a.weights[k];
    }
    return p;
}

fn vertex_of(id: vec3<u32>, groups: vec3<u32>) -> u32 {
    return id.y * groups.x * 64u + id.x;
}

@compute @workgroup_size(64)
fn deform(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let v = vertex_of(id, groups);
    if v >= frame.n_anchored {
        return;
    }
    var p = carried(v);
    let opposite = anchors[v].opposite;
    if opposite != v {
        p += anchors[v].into * (CRUMBS * min(length(p - carried(opposite)) / WORN, 1.0));
    }
    positions[3u * v] = p.x;
    positions[3u * v + 1u] = p.y;
    positions[3u * v + 2u] = p.z;
}

fn position_of(v: u32) -> vec3<f32> {
    return vec3<f32>(positions[3u * v], positions[3u * v + 1u], positions[3u * v + 2u]);
}

@compute @workgroup_size(64)
fn normals(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let v = vertex_of(id, groups);
    if v >= frame.n_anchored {
        return;
    }
    // Weighted by area.
    var sum = vec3<f32>(0.0);
    let first = anchors[v].first;
    for (var k = first; k < first + anchors[v].n; k++) {
        let t = triangles[incident[k]];
        let a = position_of(t.x);
        sum += cross(position_of(t.y) - a, position_of(t.z) - a);
    }
    let n = sum * (1.0 / max(length(sum), 1e-20));
    attributes[6u * v] = n.x;
    attributes[6u * v + 1u] = n.y;
    attributes[6u * v + 2u] = n.z;
}
