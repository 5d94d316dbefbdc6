// What each sample of an opaque frame shows.
// For each sample: facing and number of the triangle, and the depth's bits; no depth where nothing is.
@group(0) @binding(5) var<storage, read_write> hits: array<vec2<u32>>;
// Of samples without a list: kind, facing and number of the nearest triangle, and its depth's bits.
@group(0) @binding(9) var nearest: texture_2d<u32>;

fn without_list(at: vec2<u32>) -> vec2<u32> {
    let f = textureLoad(nearest, at, 0).xy;
    // A face of the bone seen from behind is an edge that turns away: from outside, it hides nothing.
    let is_seen = f.y != 0u && (kind_of(f.yx) != BONE || is_front(f.yx));
    return select(vec2<u32>(0u), vec2<u32>(f.x & (IS_BACK | TRIANGLE), f.y), is_seen);
}

@compute @workgroup_size(8, 8)
fn first(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= frame.size.x || id.y >= frame.rows {
        return;
    }
    let sample = (id.y + frame.band) * frame.size.x + id.x;
    let head = heads[id.y * frame.size.x + id.x];
    if head == 0u && frame.has_nearest != 0u {
        hits[sample] = without_list(vec2<u32>(id.x, id.y + frame.band));
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
                var other = gap_before;
                if is_front(f) {
                    other = behind(head, f, true);
                }
                is_visible = !is_closed(f, other);
            }
            gap_before = f;
        }
        if is_visible {
            hit = vec2<u32>(f.y & (IS_BACK | TRIANGLE), f.x);
            break;
        }
        f = behind(head, f, false);
    }
    hits[sample] = hit;
}
