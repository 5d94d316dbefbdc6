// Sorts each sample's list and walks it front to back: twin of csg.rs and of Job::sample in frame.rs.
@group(0) @binding(7) var<storage, read> heads: array<u32>;
@group(0) @binding(8) var<storage, read> nodes: array<u32>;

const CLOSED: f32 = 0.03;
const FAINT: f32 = 0.01;
const DETAILED: f32 = 0.25;

// Lists up to so long are sorted at once; of longer ones the next fragment is looked for each time.
const SHORT: u32 = 16u;
const NONE: vec2<u32> = vec2<u32>(0xffffffffu, 0xffffffffu);

var<private> sorted: array<vec2<u32>, SHORT>;

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
    let counted = vec3<bool>(kind <= SEAM, kind == KERF, kind == GAP);
    return counts + select(vec3<i32>(0), vec3<i32>(step), counted);
}

fn is_cut(counts: vec3<i32>) -> bool {
    return counts.y > 0 || counts.z > 0;
}

// Whether `other`, the next face of the crack, is right at this one.
fn is_closed(face: vec2<u32>, other: vec2<u32>) -> bool {
    return other.x != NONE.x && is_front(other) != is_front(face)
        && abs(bitcast<f32>(other.x) - bitcast<f32>(face.x)) < CLOSED;
}

@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= frame.size.x || id.y >= frame.rows {
        return;
    }
    let at = vec2<u32>(id.x, id.y + frame.band);
    let sample = at.y * frame.size.x + at.x;
    let head = heads[id.y * frame.size.x + id.x];
    if head == 0u {
        hits[sample] = vec2<u32>(0u);
        colors[sample] = vec4<f32>(0.0, 0.0, 0.0, 1.0);
        return;
    }
    // Every volume that the eye is in is left once more than entered.
    var counts = vec3<i32>(0);
    var n = 0u;
    for (var node = head; node != 0u; node = nodes[3u * node - 3u]) {
        let f = vec2<u32>(nodes[3u * node - 2u], nodes[3u * node - 1u]);
        counts = passed(counts, kind_of(f), !is_front(f));
        if n < SHORT {
            var k = n;
            for (; k > 0u && is_before(f, sorted[k - 1u]); k--) {
                sorted[k] = sorted[k - 1u];
            }
            sorted[k] = f;
        }
        n++;
    }
    var hit = vec2<u32>(0u);
    var color = vec3<f32>(0.0);
    var through = 1.0;
    var f = vec2<u32>(0u);
    var gap_before = NONE;
    for (var k = 0u; k < n; k++) {
        if n <= SHORT {
            f = sorted[k];
        } else {
            f = behind(head, f, false);
        }
        let kind = kind_of(f);
        let before = counts;
        counts = passed(counts, kind, is_front(f));
        var is_visible = kind == SOLID;
        if kind == WITHIN {
            is_visible = counts.x > 0;
        } else if kind == BONE {
            is_visible = !is_cut(counts) && (before.x > 0) != (counts.x > 0);
        } else if kind == KERF || kind == GAP {
            is_visible = counts.x > 0 && is_cut(before) != is_cut(counts);
        }
        if kind == GAP {
            if is_visible {
                var other = gap_before;
                if is_front(f) {
                    other = NONE;
                    if n <= SHORT {
                        for (var j = k + 1u; j < n; j++) {
                            if kind_of(sorted[j]) == GAP {
                                other = sorted[j];
                                break;
                            }
                        }
                    } else {
                        other = behind(head, f, true);
                    }
                }
                is_visible = !is_closed(f, other);
            }
            gap_before = f;
        }
        if !is_visible {
            continue;
        }
        if hit.x == 0u {
            hit = vec2<u32>((f.y & TRIANGLE) + 1u, f.x);
        }
        let s = surface_at(f.y, at, bitcast<f32>(f.x));
        if frame.is_transparent == 0u {
            color = s.normal;
            break;
        }
        let share = through * opacity(s);
        color += shade(s, 1.0, share > DETAILED) * share;
        through -= share;
        if through <= FAINT {
            break;
        }
    }
    hits[sample] = hit;
    colors[sample] = vec4<f32>(color, through);
}
