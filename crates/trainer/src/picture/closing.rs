//! Triangles that close a surface which the crack has opened: they count and are never shown.
use osteotome_mechanics::geometry::Vec3;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// A triangle's edges, as it is run through.
pub fn edges([a, b, c]: &[u32; 3]) -> [[u32; 2]; 3] {
    [[*a, *b], [*b, *c], [*c, *a]]
}

/// Edges that are run through more often one way than the other, as often as that, the way they are run through.
pub fn open_edges(edges: impl Iterator<Item = [u32; 2]>) -> Vec<[u32; 2]> {
    let key = |[a, b]: [u32; 2]| (a.min(b), a.max(b));
    let mut edges: Vec<[u32; 2]> = edges.collect();
    edges.sort_unstable_by_key(|e| key(*e));
    let mut open = Vec::new();
    for same in edges.chunk_by(|e, f| key(*e) == key(*f)) {
        let (a, b) = key(same[0]);
        let n_up = same.iter().filter(|e| e[0] == a).count();
        let n_down = same.len() - n_up;
        let way = if n_up > n_down { [a, b] } else { [b, a] };
        open.extend(std::iter::repeat_n(way, n_up.abs_diff(n_down)));
    }
    open
}

/// Fills what is open: each hole by triangles from one of its corners.
pub fn fill(edges: impl Iterator<Item = [u32; 2]>) -> Vec<[u32; 3]> {
    // What runs one way too often is to be run the other way.
    let mut next: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for [to, from] in open_edges(edges) {
        next.entry(from).or_default().push(to);
    }
    let mut holes = Vec::new();
    while let Some(start) = next.iter().find(|(_, to)| !to.is_empty()).map(|(v, _)| *v) {
        let mut path = vec![start];
        while let Some(v) = next.get_mut(&path[path.len() - 1]).and_then(Vec::pop) {
            if let Some(k) = path.iter().position(|p| *p == v) {
                holes.push(path.split_off(k));
                path.push(v);
                if k == 0 && next.get(&v).is_none_or(Vec::is_empty) {
                    break;
                }
            } else {
                path.push(v);
            }
        }
    }
    let fan = |hole: &Vec<u32>| {
        let corners = 1..hole.len() - 1;
        let from_first = corners.map(|k| [hole[0], hole[k], hole[k + 1]]);
        from_first.collect::<Vec<_>>()
    };
    holes.iter().flat_map(fan).collect()
}

/// For each vertex of some edges the nearest one of `rim` in the same fragment. `place` gives where one is, and its fragment.
pub fn nearest(
    lips: &[[u32; 2]],
    rim: &[[u32; 2]],
    place: impl Fn(u32) -> (Vec3, u32),
) -> BTreeMap<u32, u32> {
    let ends: Vec<_> = rim.iter().map(|[v, _]| (*v, place(*v))).collect();
    let to = |v: u32| {
        let (at, of) = place(v);
        let off = |end: &&(u32, (Vec3, u32))| (end.1.0 - at).norm_squared();
        let own = ends.iter().filter(|end| end.1.1 == of);
        Some((v, own.min_by(|a, b| off(a).total_cmp(&off(b)))?.0))
    };
    let vertices: BTreeSet<u32> = lips.iter().flatten().copied().collect();
    vertices.into_iter().filter_map(to).collect()
}

/// Triangles between the open edges of two surfaces that end near each other, from those of `lips` to what is `nearest` of `rim`.
pub fn join(lips: &[[u32; 2]], rim: &[[u32; 2]], nearest: &HashMap<u32, u32>) -> Vec<[u32; 3]> {
    let back: HashMap<u32, u32> = rim.iter().map(|[from, to]| (*to, *from)).collect();
    let forth: HashMap<u32, u32> = rim.iter().map(|[from, to]| (*from, *to)).collect();
    let mut between = Vec::new();
    for &[u, v] in lips {
        let (from, to) = (nearest[&u], nearest[&v]);
        between.push([v, u, from]);
        let ways = [&back, &forth].map(|next| along(next, from, to));
        let way = ways.into_iter().flatten().min_by_key(Vec::len);
        let way = way.unwrap_or_else(|| vec![from, to]);
        between.extend(way.windows(2).map(|e| [v, e[0], e[1]]));
    }
    between
}

/// The vertices on the way from one to another; `None` if it is far.
fn along(next: &HashMap<u32, u32>, from: u32, to: u32) -> Option<Vec<u32>> {
    const FAR: usize = 60;
    let mut way = vec![from];
    while way[way.len() - 1] != to && way.len() < FAR {
        way.push(*next.get(&way[way.len() - 1])?);
    }
    way.ends_with(&[to]).then_some(way)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rings of so many points at so many radii, the first on the inside.
    fn ring(of: [(u32, f64); 2]) -> impl Fn(u32) -> Vec3 {
        move |v| {
            let (k, (n, r)) = match v < of[0].0 {
                true => (v, of[0]),
                false => (v - of[0].0, of[1]),
            };
            let turn = std::f64::consts::TAU * f64::from(k) / f64::from(n);
            Vec3::new(r * turn.cos(), r * turn.sin(), 0.0)
        }
    }

    #[test]
    fn two_rings_of_unlike_points_are_joined_without_a_hole() {
        for (inner, outer) in [(7, 40), (40, 7), (12, 12), (5, 200)] {
            let at = ring([(inner, 1.0), (outer, 1.5)]);
            let around = |first: u32, n: u32| move |k: u32| [first + k, first + (k + 1) % n];
            let lips: Vec<_> = (0..inner).map(around(0, inner)).collect();
            let rim = (0..outer).map(around(inner, outer)).map(|[a, b]| [b, a]);
            let rim: Vec<_> = rim.collect();
            let nearest = nearest(&lips, &rim, |v| (at(v), 0));
            let between = join(&lips, &rim, &nearest.into_iter().collect());
            let all = between.iter().flat_map(edges).chain(lips).chain(rim);
            assert_eq!(open_edges(all), Vec::<[u32; 2]>::new(), "{inner}, {outer}");
            // Once around, nothing twice: the area between the two polygons.
            let area = |t: &[u32; 3]| {
                let [a, b, c] = t.map(&at);
                0.5 * (b - a).cross(&(c - a)).z
            };
            let polygon = |n: u32, r: f64| {
                0.5 * f64::from(n) * r * r * (std::f64::consts::TAU / f64::from(n)).sin()
            };
            let wanted = polygon(outer, 1.5) - polygon(inner, 1.0);
            let found: f64 = between.iter().map(area).sum();
            assert!((found.abs() - wanted).abs() < 1e-9, "{found}, {wanted}");
        }
    }

    #[test]
    fn what_is_left_open_is_filled() {
        // A tetrahedron without one of its faces.
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3]];
        let filled = fill(faces.iter().flat_map(edges));
        assert_eq!(filled.len(), 1);
        let all = faces.iter().chain(&filled).flat_map(edges);
        assert!(open_edges(all).is_empty());
    }
}
