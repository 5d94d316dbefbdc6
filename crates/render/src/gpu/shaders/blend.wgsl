// All layers of each sample of a transparent frame.
// For each sample: blended colour and what shines through.
@group(0) @binding(6) var<storage, read_write> colors: array<vec4<f32>>;

const FAINT: f32 = 0.01;
const DETAILED: f32 = 0.25;

// Lists up to so long are sorted at once; of longer ones the next fragment is looked for each time.
const SHORT: u32 = 16u;

var<private> sorted: array<vec2<u32>, SHORT>;

@compute @workgroup_size(8, 8)
fn blend(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= frame.size.x || id.y >= frame.rows {
        return;
    }
    let at = vec2<u32>(id.x, id.y + frame.band);
    let sample = at.y * frame.size.x + at.x;
    let head = heads[id.y * frame.size.x + id.x];
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
    for (var k = 0u; k < n && through > FAINT; k++) {
        if n <= SHORT {
            f = sorted[k];
        } else {
            f = behind(head, f, false);
        }
        let kind = kind_of(f);
        let before = counts;
        counts = passed(counts, kind, is_front(f));
        var is_visible = is_seen(kind, before, counts);
        if kind == GAP {
            if is_visible {
                is_visible = !is_closed(f, gap_before, at) && !is_closed(f, behind(head, f, true), at);
            }
            gap_before = f;
        }
        if !is_visible {
            continue;
        }
        if hit.y == 0u {
            hit = vec2<u32>(f.y & (IS_BACK | TRIANGLE), f.x);
        }
        let s = surface_at(f.y, at, bitcast<f32>(f.x));
        let share = through * opacity(s);
        color += shade(s, 1.0, share > DETAILED) * share;
        through -= share;
    }
    hits[at.y * frame.stride + at.x] = hit;
    colors[sample] = vec4<f32>(color, through);
}
