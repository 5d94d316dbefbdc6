//! Blocks instead of jaws: what the skins of a cracked body must be whatever moves.
#![allow(clippy::print_stderr)] // a skipped test says so
use super::anchored::{Skin, drawn_cells, moved_cells, piece_of};
use super::bone_skin::{BoneSkin, Places, Slits};
use super::closing::edges;
use super::crack_skin::{GapSkin, KerfSkin, broken_sheets, gap_skin, kerf_skin, unparted};
use super::restore::Restored;
use crate::engine::cut_since;
use crate::scenario::{BSSO_RIGHT, Source, load};
use crate::session::GrowthSample;
use osteotome_mechanics::bone::{Supports, TetMaterial};
use osteotome_mechanics::crack::growth::GrowthLengths;
use osteotome_mechanics::crack::{CrackSurface, CrackedBody, Sheet, Solid};
use osteotome_mechanics::geometry::{MeshDistance, TetLocator, TetMesh, TriMesh, Vec3, block_mesh};
use osteotome_render::skin::{Part, Skin as Drawn};
use osteotome_render::{Camera, Frame, Kind, Material, Options, Renderer, Scene, Texture};
use std::collections::HashMap;
use std::sync::Arc;

const SIZE: Vec3 = Vec3::new(24.0, 12.0, 12.0);

/// A soft block with its crack.
fn cracked(sheets: Vec<Sheet>) -> CrackedBody {
    let mesh = block_mesh(Vec3::zeros(), SIZE, [6, 3, 3]);
    let h = mesh.mean_edge_length();
    let solid = Solid {
        locator: TetLocator::new(&mesh),
        materials: vec![TetMaterial::isotropic(1000.0, 0.3, 1.0); mesh.tets().len()],
        supports: Supports::near(&mesh, &[], 0.0, 1e-6, 1000.0),
        lengths: GrowthLengths::for_element_size(h),
        mesh,
    };
    CrackedBody::new(Arc::new(solid), CrackSurface { sheets }).unwrap()
}

/// A flat sheet over a parallelogram.
fn sheet(corner: [f64; 3], a: [f64; 3], b: [f64; 3], kerf: f64) -> Sheet {
    let [o, a, b] = [corner, a, b].map(Vec3::from);
    Sheet {
        mesh: TriMesh {
            vertices: vec![o, o + a, o + b, o + a + b],
            triangles: vec![[0, 1, 2], [2, 1, 3]],
        },
        kerf: vec![0.5 * kerf; 4],
        ..Sheet::default()
    }
}

/// Right through, a little askew.
fn through(kerf: f64) -> Sheet {
    sheet([10.3, -3.0, -3.0], [1.1, 18.0, 0.0], [0.9, 0.0, 18.0], kerf)
}

/// The block's surface, finer than its mesh.
fn surface(mesh: &TetMesh) -> TriMesh {
    let mut s = TriMesh {
        vertices: mesh.nodes().to_vec(),
        triangles: mesh.boundary_faces().to_vec(),
    };
    for _ in 0..2 {
        let mut middle: HashMap<[u32; 2], u32> = HashMap::new();
        let mut finer = Vec::new();
        for [a, b, c] in s.triangles {
            let mut mid = |p: u32, q: u32| {
                *middle.entry([p.min(q), p.max(q)]).or_insert_with(|| {
                    let m = 0.5 * (s.vertices[p as usize] + s.vertices[q as usize]);
                    s.vertices.push(m);
                    s.vertices.len() as u32 - 1
                })
            };
            let (ab, bc, ca) = (mid(a, b), mid(b, c), mid(c, a));
            finer.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        s.triangles = finer;
    }
    s
}

struct Skins {
    bone: BoneSkin,
    gap: GapSkin,
    kerf: KerfSkin,
}

fn skins(body: &CrackedBody) -> Skins {
    let surface = surface(&body.solid.mesh);
    let region = MeshDistance::new(surface.clone());
    let gap = gap_skin(body, &region);
    Skins {
        bone: Slits::default().skin(body, &surface, &Places::new(body, &surface), &gap),
        kerf: kerf_skin(body, &region),
        gap,
    }
}

impl Skins {
    fn check_closed(&self) {
        let closed = |name: &str, lists: &[&[[u32; 3]]]| {
            let mut balance: HashMap<[u32; 2], i32> = HashMap::new();
            for t in lists.iter().flat_map(|l| l.iter()) {
                for k in 0..3 {
                    let [a, b] = [t[k], t[(k + 1) % 3]];
                    *balance.entry([a.min(b), a.max(b)]).or_default() += if a < b { 1 } else { -1 };
                }
            }
            let open = balance.values().filter(|n| **n != 0).count();
            assert_eq!(open, 0, "{name}: edges are open");
        };
        closed("bone", &[&self.bone.skin.triangles, &self.bone.seams]);
        closed(
            "gap",
            &[&self.gap.skin.triangles, &self.gap.sawn, &self.gap.walls],
        );
        closed("kerf", &[&self.kerf.skin.triangles, &self.kerf.seams]);
    }

    /// Of all triangles that are shown, the largest change of an edge's length \[mm\].
    fn stretch(&self, moved: &[[Vec3; 4]]) -> f32 {
        let of = |skin: &Skin, triangles: &[[u32; 3]]| {
            let at = skin.drawn(vec![]).positions(&single(moved));
            let length = |p: &[[f32; 3]], a: u32, b: u32| {
                let [p, q] = [a, b].map(|v| p[v as usize]);
                (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>().sqrt()
            };
            let edges = triangles
                .iter()
                .flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]);
            edges
                .map(|[a, b]| (length(&at, a, b) - length(&skin.rest, a, b)).abs())
                .fold(0.0, f32::max)
        };
        let (bone, kerf, gap) = (&self.bone.skin, &self.kerf.skin, &self.gap.skin);
        let of_bone = of(bone, &bone.triangles);
        let of_kerf = of(kerf, &kerf.triangles);
        let of_gap = of(gap, &gap.triangles).max(of(gap, &self.gap.sawn));
        of_bone.max(of_kerf).max(of_gap)
    }

    /// For the renderer: the bone is mesh 0.
    fn drawn(&self) -> [Drawn; 3] {
        let part = |kind, triangles: &[[u32; 3]]| Part {
            kind,
            material: Material {
                color: [0.5; 3],
                opacity: 1.0,
                gloss: 0.0,
                texture: Texture::Plain,
            },
            is_smooth: kind == Kind::Bone,
            triangles: triangles.to_vec(),
        };
        [
            self.bone.drawn(vec![
                part(Kind::Bone, &self.bone.skin.triangles),
                part(Kind::Seam, &self.bone.seams),
            ]),
            self.kerf.skin.drawn(vec![
                part(Kind::Kerf, &self.kerf.skin.triangles),
                part(Kind::KerfSeam, &self.kerf.seams),
            ]),
            self.gap.drawn(vec![
                part(Kind::Gap, &self.gap.skin.triangles),
                part(Kind::Gap, &self.gap.sawn),
                part(Kind::GapSeam, &self.gap.walls),
            ]),
        ]
    }

    /// What is seen from `eye`: first mesh plus one, and distance, pixel by pixel. Mesh 0 is the bone.
    fn seen(&self, moved: &[[Vec3; 4]], eye: [f32; 3]) -> (Vec<u32>, Vec<f32>) {
        let frame = look(&mut Renderer::processor(), &self.drawn(), moved, eye);
        (frame.ids, frame.depths)
    }
}

fn look(renderer: &mut Renderer, skins: &[Drawn], moved: &[[Vec3; 4]], eye: [f32; 3]) -> Frame {
    let scene = Scene {
        skins,
        cells: &single(moved),
        ..Scene::default()
    };
    let options = Options {
        width: 400,
        height: 300,
        samples: 1,
        is_transparent: false,
    };
    let camera = Camera::look_at(eye, [12.5, 6.0, 6.0], [0.0, 0.0, 1.0], 30.0);
    renderer.frame(&scene, &camera, &options)
}

/// Each piece moved by itself.
fn moved(body: &CrackedBody, by: impl Fn(u32) -> Vec3) -> Vec<[Vec3; 4]> {
    let mut cells = moved_cells(body, &vec![0.0; body.system.n()]);
    for (c, nodes) in (0u32..).zip(&mut cells) {
        let way = by(piece_of(body, c));
        nodes.iter_mut().for_each(|p| *p += way);
    }
    cells
}

#[test]
fn no_triangle_spans_the_gap_and_one_sees_through_it() {
    let body = cracked(vec![through(0.0)]);
    assert_eq!(body.fragments.count(), 2);
    let skins = skins(&body);
    skins.check_closed();
    let apart = moved(&body, |piece| Vec3::new(-3.0, 0.4, 0.7) * f64::from(piece));
    assert!(skins.stretch(&apart) < 1e-4, "{}", skins.stretch(&apart));
    // Along the crack: nothing hangs in the gap.
    let (ids, _) = skins.seen(&apart, [9.5, -70.0, 6.0]);
    let row = &ids[150 * 400..151 * 400];
    let first = row.iter().position(|id| *id != 0).unwrap();
    let last = row.iter().rposition(|id| *id != 0).unwrap();
    let open: Vec<usize> = (first..last).filter(|x| row[*x] == 0).collect();
    assert!(open.len() > 8, "{} pixels of the gap are open", open.len());
    assert_eq!(
        open.len(),
        open[open.len() - 1] - open[0] + 1,
        "something hangs in the gap"
    );
}

/// A bone that bulges out of its coarse mesh between the nodes, as jaws do: there the crack must still reach all through.
#[test]
fn the_crack_is_led_out_of_a_bone_that_bulges() {
    let body = cracked(vec![through(0.0)]);
    let h = body.solid.lengths.h;
    let mut surface = surface(&body.solid.mesh);
    for p in &mut surface.vertices {
        // Ribs across the crack on each side, between the mesh's nodes and the middles of its edges, where the crack is led out.
        let bulge = |k: usize| f64::from(u8::from(p[k].round() as i64 % 4 == 1));
        let out = [1, 2].map(|k| match p[k] {
            v if v < 1e-9 => -1.0,
            v if v > SIZE[k] - 1e-9 => 1.0,
            _ => 0.0,
        });
        *p += Vec3::new(0.0, out[0] * bulge(2), out[1] * bulge(1)) * (0.8 * h);
    }
    let region = MeshDistance::new(surface.clone());
    let gap = gap_skin(&body, &region);
    let at = |v: u32| Vec3::from(gap.skin.rest[v as usize].map(f64::from));
    // Along the border they lead from a face to what closes it off, which lies on it as long as nothing has moved.
    let is_border = |t: &&[u32; 3]| edges(t).iter().any(|[a, b]| at(*a) == at(*b));
    let edges = gap.walls.iter().filter(is_border).flat_map(edges);
    // Once they are led out as far as their ends need, ribs still stand higher between some of them.
    let is_within = |e: &[u32; 2]| {
        let mut shares = [0.0, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0].into_iter();
        shares.any(|s| region.signed(&at(e[0]).lerp(&at(e[1]), s)) < 0.0)
    };
    let edges: Vec<[u32; 2]> = edges.collect();
    let within = edges.iter().filter(|e| is_within(e)).count();
    assert!(edges.len() > 100);
    assert!(
        50 * within <= edges.len(),
        "{within} of {} edges of the border pass through the bone",
        edges.len()
    );
}

#[test]
fn a_closed_crack_lets_no_light_through() {
    let cut = cracked(vec![through(0.0)]);
    let whole = cracked(vec![]);
    for eye in [
        [60.0, -45.0, 40.0],
        [-30.0, 60.0, -20.0],
        [12.0, -70.0, 6.0],
    ] {
        let see = |body: &CrackedBody| skins(body).seen(&moved(body, |_| Vec3::zeros()), eye);
        let ((_, before), (ids, after)) = (see(&whole), see(&cut));
        let differ = (0..before.len())
            .filter(|i| (before[*i] - after[*i]).abs() > 0.02)
            .count();
        // The lips' corners are snapped to a 256th of a pixel: at the outline one pixel in a thousand may go either way.
        assert!(differ <= 20, "{differ} pixels differ");
        let leaks = (0..ids.len())
            .filter(|i| (ids[*i] == 0) != (before[*i] == 0.0))
            .count();
        assert!(leaks <= 20, "{leaks} pixels leak");
        assert!(
            ids.iter().all(|id| *id <= 1),
            "a closed crack shows its faces"
        );
    }
}

#[test]
fn a_sawn_slit_is_as_wide_as_the_saw() {
    let depth = 5.0;
    let saw = sheet(
        [11.9, -3.0, 15.0],
        [0.0, 18.0, 0.0],
        [0.0, 0.0, -3.0 - depth],
        0.8,
    );
    let body = cracked(vec![saw]);
    assert_eq!(body.fragments.count(), 1);
    let skins = skins(&body);
    skins.check_closed();
    // From above: of the block's width of 24 mm the slit takes .8 mm.
    let (ids, _) = skins.seen(&moved(&body, |_| Vec3::zeros()), [12.5, 5.9, 90.0]);
    let count = |wanted: fn(u32) -> bool| ids.iter().filter(|id| wanted(**id)).count() as f64;
    let share = count(|id| id == 3) / count(|id| id > 0);
    assert!((share * SIZE.x - 0.8).abs() < 0.1, "{} mm", share * SIZE.x);
}

#[test]
fn three_pieces_at_a_junction_come_apart_cleanly() {
    let half = |kerf| sheet([11.0, -3.0, 5.2], [16.0, 0.0, 0.8], [0.0, 18.0, 0.4], kerf);
    let ways = [
        Vec3::zeros(),
        Vec3::new(3.0, 0.0, 3.0),
        Vec3::new(3.0, 0.0, -3.0),
    ];
    // Broken, and sawn.
    for kerf in [0.8, 0.0] {
        let body = cracked(vec![through(kerf), half(kerf)]);
        assert_eq!(body.fragments.count(), 3);
        let skins = skins(&body);
        skins.check_closed();
        let apart = moved(&body, |piece| ways[piece as usize]);
        let stretch = skins.stretch(&apart);
        assert!(stretch < 1e-4, "{stretch} mm, kerf {kerf}");
        // Nor does anything that is not shown span two pieces: what would sweep through the bone of others.
        let spans = |skin: &Skin, t: &[u32; 3]| {
            let of = t.map(|v| piece_of(&body, skin.anchors[v as usize].cell));
            of[0] != of[1] || of[1] != of[2]
        };
        let (bone, gap, of_kerf) = (&skins.bone, &skins.gap, &skins.kerf);
        for (skin, unseen) in [
            (&bone.skin, &bone.seams),
            (&gap.skin, &gap.walls),
            (&of_kerf.skin, &of_kerf.seams),
        ] {
            let n = unseen.iter().filter(|t| spans(skin, t)).count();
            assert_eq!(n, 0, "of {} triangles, kerf {kerf}", unseen.len());
        }
    }
}

/// In red: until a crack parts fragments, as it is; then what parted them, all of it on each.
#[test]
fn a_crack_is_seen_on_both_fragments() {
    let edge = sheet([11.7, -3.0, 15.0], [0.5, 18.0, 0.0], [0.3, 0.0, -9.0], 0.0);
    let body = cracked(vec![edge]);
    assert_eq!(body.fragments.count(), 1);
    let gap = skins(&body).gap;
    let broken = broken_sheets(&body);
    assert_eq!(unparted(&body, &broken, &gap).len(), 2);
    assert!(gap.apart.is_empty());

    let body = cracked(vec![through(0.0)]);
    let gap = skins(&body).gap;
    let broken = broken_sheets(&body);
    assert_eq!(broken.triangles.len(), 2);
    assert!(unparted(&body, &broken, &gap).is_empty());
    let mut areas = [0.0; 2];
    for t in &gap.apart {
        let of = t.map(|v| piece_of(&body, gap.skin.anchors[v as usize].cell));
        assert!(of.iter().all(|piece| *piece == of[0]), "{of:?}");
        let [a, b, c] = t.map(|v| Vec3::from(gap.skin.rest[v as usize].map(f64::from)));
        areas[of[0] as usize] += 0.5 * (b - a).cross(&(c - a)).norm();
    }
    // It is led out of the block on all sides.
    assert!(areas[0] > SIZE.y * SIZE.z, "{areas:?}");
    assert!((areas[0] - areas[1]).abs() < 1e-3 * areas[0], "{areas:?}");

    // The explicit crack is whole, though one sheet ends beyond the other, and no triangle of it spans two pieces.
    let half = sheet([11.0, -3.0, 5.2], [16.0, 0.0, 0.8], [0.0, 18.0, 0.4], 0.0);
    let body = cracked(vec![through(0.0), half]);
    let broken = broken_sheets(&body);
    assert_eq!(broken.triangles.len(), 4);
    for t in &broken.triangles {
        let of = t.map(|v| piece_of(&body, broken.anchors[v as usize].cell));
        assert!(of.iter().all(|piece| *piece == of[0]), "{of:?}");
    }
}

#[test]
fn a_graphics_device_sees_three_pieces_as_the_processor_does() {
    let mut device = match Renderer::device() {
        Ok(device) => device,
        Err(why) => return eprintln!("SKIPPED: {why}, so no skins were drawn there"),
    };
    let half = sheet([11.0, -3.0, 5.2], [16.0, 0.0, 0.8], [0.0, 18.0, 0.4], 0.0);
    let body = cracked(vec![through(0.0), half]);
    let skins = skins(&body).drawn();
    for apart in [0.0, 0.4, 3.0] {
        let way = |piece| Vec3::new(1.0, 0.0, [0.0, 1.0, -1.0][piece as usize]) * apart;
        let moved = moved(&body, |piece| {
            if piece == 0 {
                Vec3::zeros()
            } else {
                way(piece)
            }
        });
        let eye = [20.0, -70.0, 16.0];
        let [on_device, twin] = [&mut device, &mut Renderer::processor()]
            .map(|renderer| look(renderer, &skins, &moved, eye));
        let n = twin.ids.len();
        let different = (0..n).filter(|i| on_device.ids[*i] != twin.ids[*i]).count();
        assert!(
            different as f64 <= 1e-4 * n as f64,
            "{apart} mm apart: {different} pixels differ"
        );
    }
    assert!(
        device.place() != Renderer::processor().place(),
        "{}",
        device.place()
    );
}

fn single(moved: &[[Vec3; 4]]) -> Vec<[[f32; 3]; 4]> {
    let one = |nodes: &[Vec3; 4]| nodes.map(|p| p.cast::<f32>().into());
    moved.iter().map(one).collect()
}

#[test]
fn cells_are_moved_alike_for_all_frames() {
    let body = cracked(vec![through(0.0)]);
    let x: Vec<f64> = (0..body.system.n())
        .map(|i| (0.7 * i as f64).sin())
        .collect();
    assert_eq!(
        drawn_cells(&body, &x).to_vec(),
        single(&moved_cells(&body, &x))
    );
}

/// From growth to growth, up to the split and back: what was kept of the slits before gives the surface that one made anew has.
#[test]
fn a_skin_that_follows_the_crack_is_the_one_made_anew() {
    let edge = sheet([11.7, -3.0, 15.0], [0.5, 18.0, 0.0], [0.3, 0.0, -9.0], 0.0);
    let mut bodies = vec![cracked(vec![edge])];
    while bodies.len() < 12 {
        let body = bodies.last().unwrap();
        let fronts = body.fronts();
        let Some(front) = fronts.first() else { break };
        let n = front.vertices.len();
        // Ahead at one end first.
        let ahead = |k: usize| Vec3::new(0.1, 0.0, -2.0 * (k + bodies.len()) as f64 / n as f64);
        let advance: Vec<Vec3> = (0..n).map(ahead).collect();
        let growth = body.advanced(&[(front, &advance)]);
        let grown = body.grown(growth).unwrap();
        bodies.push(grown);
    }
    assert_eq!(bodies.last().unwrap().fragments.count(), 2);
    bodies.push(bodies[2].clone());
    let surface = surface(&bodies[0].solid.mesh);
    let places = Places::new(&bodies[0], &surface);
    let region = MeshDistance::new(surface.clone());
    let mut slits = Slits::default();
    for body in &bodies {
        let gap = gap_skin(body, &region);
        let [kept, anew] =
            [&mut slits, &mut Slits::default()].map(|s| s.skin(body, &surface, &places, &gap));
        assert!(kept == anew);
    }
}

/// A growth recorded and repeated gives the same body.
#[test]
fn a_recorded_growth_is_repeated_exactly() {
    let edge = sheet([11.7, -3.0, 15.0], [0.5, 18.0, 0.0], [0.3, 0.0, -9.0], 0.0);
    let before = cracked(vec![edge]);
    let fronts = before.fronts();
    let advance = vec![Vec3::new(0.3, 0.0, -2.5); fronts[0].vertices.len()];
    let growth = before.advanced(&[(&fronts[0], &advance)]);
    assert!(!growth.newly_cut.is_empty(), "the crack grew");
    let after = before.grown(growth).unwrap();
    let n_edges = before.solid.mesh.edges().len() as u32;
    let (cut, seats) = cut_since(&after.cuts, &before.cuts, n_edges);
    let grown = &after.crack.sheets[0];
    let sample = GrowthSample {
        time: 0.5,
        vertices: grown.mesh.vertices.iter().map(|v| (*v).into()).collect(),
        triangles: grown.mesh.triangles.clone(),
        kerf: grown.kerf.clone(),
        generation: 1,
        front: vec![],
        area: 0.0,
        fragments: 1,
        severed: false,
        sheets: vec![[
            grown.mesh.vertices.len() as u32,
            grown.mesh.triangles.len() as u32,
        ]],
        cut,
        seats,
        tips: vec![],
    };
    let json = serde_json::to_string(&sample).unwrap();
    let start = GrowthSample {
        generation: 0,
        ..sample.clone()
    };
    let read = [start, serde_json::from_str(&json).unwrap()];
    let mut restored = Restored::new(&before);
    restored.go_to(1, &read).unwrap();
    let body = restored.body();
    assert_eq!(format!("{:?}", body.cuts), format!("{:?}", after.cuts));
    assert_eq!(
        format!("{:?}", body.topology),
        format!("{:?}", after.topology)
    );
    assert_eq!(body.crack.sheets[0].mesh, grown.mesh);
    assert_eq!(body.system.n(), after.system.n());
    restored.go_to(0, &read).unwrap();
    assert_eq!(restored.body().system.n(), before.system.n());
    let error = restored.go_to(2, &read).unwrap_err().to_string();
    assert!(error.contains("growth 2"), "{error}");
    let mut bad = read[1].clone();
    bad.cut.push((n_edges, 0.5));
    let error = Restored::new(&before)
        .go_to(1, &[read[0].clone(), bad])
        .unwrap_err();
    assert!(error.to_string().contains("does not have"), "{error}");
}

/// On a jaw whose coarse mesh ends before the ridge, what the saw has parted leaves the bone in the saw's slit, not beside it.
#[test]
fn sawn_faces_leave_the_bone_where_the_saw_came_in() {
    let source = Source::Text {
        name: "test".into(),
        text: BSSO_RIGHT.into(),
    };
    let scenario = load(&source, &[], std::path::Path::new("/")).unwrap();
    let prepared = crate::engine::prepare(&scenario, &mut |_, _| {}).unwrap();
    let (body, region) = (&prepared.bone.cracked, &*prepared.bone.body.region.0);
    let gap = gap_skin(body, region);
    let at = |v: u32| Vec3::from(gap.skin.rest[v as usize].map(f64::from));
    let off_saw = |p: &Vec3| {
        let foot = |s: &Sheet| {
            let (_, t, w) = s.closest(p)?;
            let corners = s.mesh.corners(t);
            Some((0..3).map(|k| corners[k] * w[k]).sum::<Vec3>())
        };
        let feet = body.crack.sheets.iter().filter_map(foot);
        feet.map(|q| (q - p).norm()).fold(f64::INFINITY, f64::min)
    };
    // The slit is half a kerf wide on both sides of the saw's sheet.
    const HALF_KERF: f64 = 0.4;
    let mut vertices: Vec<u32> = gap.sawn.iter().flatten().copied().collect();
    vertices.sort_unstable();
    vertices.dedup();
    // Nothing has broken yet: in the bone all is within the slit, so that no flake stays between.
    let within = vertices.iter().map(|v| at(*v));
    let within: Vec<f64> = (within.filter(|p| region.signed(p) < -0.5))
        .map(|p| off_saw(&p))
        .collect();
    let flakes = within.iter().filter(|d| **d > HALF_KERF).count();
    assert!(within.len() > 100);
    assert!(
        100 * flakes <= within.len(),
        "{flakes} of {}: {within:.2?}",
        within.len()
    );
    // Where it comes through the bone's surface.
    let edges = gap
        .sawn
        .iter()
        .flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]);
    let through = |e: [u32; 2]| {
        let [mut low, mut high] = e.map(at);
        if !(region.signed(&low) < 0.0 && region.signed(&high) > 0.1) {
            return None;
        }
        for _ in 0..30 {
            let middle = low.lerp(&high, 0.5);
            let end = if region.signed(&middle) < 0.0 {
                &mut low
            } else {
                &mut high
            };
            *end = middle;
        }
        Some(off_saw(&low))
    };
    let out: Vec<f64> = edges.filter_map(through).collect();
    let beside = out.iter().filter(|d| **d > HALF_KERF).count();
    assert!(out.len() > 50);
    assert!(
        20 * beside <= out.len(),
        "{beside} of {}: {out:.1?}",
        out.len()
    );
}
