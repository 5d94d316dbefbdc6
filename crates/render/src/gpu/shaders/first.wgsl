// What each sample of an opaque frame shows.
// For each sample: facing and number of the triangle, and the depth's bits; no depth where nothing is.
@group(0) @binding(5) var<storage, read_write> hits: array<vec2<u32>>;
// Numbers of the tiles that have lists; all others have been filled.
@group(0) @binding(9) var<storage, read> tiles: array<u32>;

const TILE: u32 = 64u;

// A group for each 8 x 8 samples of a tile.
@compute @workgroup_size(8, 8)
fn first(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let across = (frame.size.x + TILE - 1u) / TILE;
    let tile = tiles[group.x];
    let corner = TILE * vec2<u32>(tile % across, tile / across);
    let id = corner + 8u * vec2<u32>(group.y % 8u, group.y / 8u) + local.xy;
    if id.x >= frame.size.x || id.y >= frame.rows {
        return;
    }
    let head = heads[id.y * frame.size.x + id.x];
    if head == 0u {
        return;
    }
    // Every volume that the eye is in is left once more than entered.
    var counts = vec3<i32>(0);
    var f = NONE;
    for (var at = head; at != 0u; at = nodes[3u * at - 3u]) {
        let g = vec2<u32>(nodes[3u * at - 2u], nodes[3u * at - 1u]);
        counts = passed(counts, kind_of(g), !is_front(g));
        if is_before(g, f) {
            f = g;
        }
    }
    // Most rays end at the first surface: the next is looked for only when it is wanted.
    var hit = vec2<u32>(0u);
    var gap_before = NONE;
    while f.x != NONE.x {
        let before = counts;
        let kind = kind_of(f);
        counts = passed(counts, kind, is_front(f));
        var is_visible = is_seen(kind, before, counts);
        if kind == GAP {
            if is_visible {
                let at = vec2<u32>(id.x, id.y + frame.band);
                is_visible = !is_closed(f, gap_before, at) && !is_closed(f, behind(head, f, true), at);
            }
            gap_before = f;
        }
        if is_visible {
            hit = vec2<u32>(f.y & (IS_BACK | TRIANGLE), f.x);
            break;
        }
        f = behind(head, f, false);
    }
    hits[(id.y + frame.band) * frame.stride + id.x] = hit;
}
