//! Meshes and cracks of the cases in `validation/`: blocks of bricks cut into six tetrahedra each, inner nodes moved at random.
use anyhow::{Context, Result};
use osteotome_anatomy::stl::to_binary_stl;
use osteotome_mechanics::geometry::{TetMesh, TriMesh, Vec3, block_mesh};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
use std::path::PathBuf;

/// Writes mesh and crack of every case.
pub fn write_all() -> Result<()> {
    for case in [
        sent(),
        inclined(),
        penny(),
        dcb(),
        skew_notch(),
        two_sheets(),
    ] {
        case.write()?;
    }
    Ok(())
}

struct Case {
    folder: &'static str,
    mesh: TetMesh,
    crack: Vec<TriMesh>,
}

impl Case {
    fn write(&self) -> Result<()> {
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
            .join("../validation")
            .join(self.folder);
        std::fs::create_dir_all(&folder)?;
        let mut crack = TriMesh::default();
        self.crack.iter().for_each(|s| crack.append(s));
        for (name, bytes) in [
            ("mesh.msh", to_binary_msh(&self.mesh)),
            ("crack.stl", to_binary_stl(&crack)),
        ] {
            let path = folder.join(name);
            std::fs::write(&path, bytes).with_context(|| path.display().to_string())?;
        }
        Ok(())
    }
}

/// `n` even steps from `min` to `max`.
fn even(min: f64, max: f64, n: usize) -> Vec<f64> {
    let at = |k: usize| min + (max - min) * k as f64 / n as f64;
    (0..=n).map(at).collect()
}

/// Even lines from `from` to `near`, then wider by `ratio` each up to `far`, in `n` and `m` steps.
fn graded(from: f64, near: f64, far: f64, [n, m]: [usize; 2], ratio: f64) -> Vec<f64> {
    let mut lines = even(from, near, n);
    let sum: f64 = (0..m).map(|k| ratio.powi(k as i32)).sum();
    let mut at = near;
    for k in 0..m {
        at += (far - near) * ratio.powi(k as i32) / sum;
        lines.push(at);
    }
    lines
}

/// Mirrored at zero.
fn mirrored(lines: &[f64]) -> Vec<f64> {
    let below = lines[1..].iter().rev().map(|x| -x);
    below.chain(lines.iter().copied()).collect()
}

/// A block on grid lines. Inner nodes move by up to `jitter` of the room they have, so that no crack lies in mesh planes.
fn block(lines: [&[f64]; 3], jitter: f64) -> TetMesh {
    let n = lines.map(|l| l.len() - 1);
    let one = Vec3::repeat(1.0);
    let even = block_mesh(Vec3::zeros(), one, n);
    let mut state = 1u64;
    let mut random = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    let place = |p: &Vec3| {
        Vec3::from_fn(|axis, _| {
            let (l, r) = (lines[axis], random());
            let i = (p[axis] * n[axis] as f64).round() as usize;
            if i == 0 || i == n[axis] {
                return l[i];
            }
            l[i] + jitter * r * (l[i + 1] - l[i]).min(l[i] - l[i - 1])
        })
    };
    let nodes = even.nodes().iter().map(place).collect();
    TetMesh::new(nodes, even.tets().to_vec())
        .expect("a jitter below a quarter turns no element over")
}

/// The parallelogram at `origin` spanned by `a` and `b`.
fn sheet(origin: [f64; 3], a: [f64; 3], b: [f64; 3]) -> TriMesh {
    let [o, a, b] = [origin, a, b].map(Vec3::from);
    TriMesh {
        vertices: vec![o, o + a, o + a + b, o + b],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

/// 10 x 2.4 x 20 mm.
fn strip_specimen() -> TetMesh {
    let x = even(0.0, 10.0, 16);
    let y = even(0.0, 2.4, 3);
    let z = mirrored(&graded(0.0, 2.5, 10.0, [4, 5], 1.4));
    block([&x, &y, &z], 0.12)
}

/// Edge crack of 4 mm in a strip of 10 mm.
fn sent() -> Case {
    Case {
        folder: "sent",
        mesh: strip_specimen(),
        crack: vec![sheet([-1.0, -1.0, 0.03], [5.0, 0.0, 0.0], [0.0, 4.4, 0.0])],
    }
}

/// The same at 45 degrees to the load.
fn inclined() -> Case {
    Case {
        folder: "inclined",
        mesh: strip_specimen(),
        crack: vec![sheet([-1.0, -1.0, -3.0], [4.0, 0.0, 4.0], [0.0, 4.4, 0.0])],
    }
}

/// A quarter of a disc of radius 3 mm between two planes of symmetry.
fn penny() -> Case {
    let side = graded(0.0, 4.5, 12.0, [7, 2], 2.0);
    let z = mirrored(&graded(0.0, 2.6, 12.0, [4, 3], 1.8));
    let (radius, n) = (3.0, 16u32);
    let mut disc = TriMesh {
        vertices: vec![Vec3::new(0.0, 0.0, 0.02)],
        triangles: vec![],
    };
    for k in 0..=n {
        let w = FRAC_PI_2 * f64::from(k) / f64::from(n);
        let at = Vec3::new(radius * w.cos(), radius * w.sin(), 0.02);
        disc.vertices.push(at);
        if k > 0 {
            disc.triangles.push([0, k, k + 1]);
        }
    }
    Case {
        folder: "penny",
        mesh: block([&side, &side, &z], 0.12),
        crack: vec![disc],
    }
}

/// Double cantilever beam: arms of 3 mm, width 1.5 mm, crack of 10 mm in 24 mm.
fn dcb() -> Case {
    let x = even(0.0, 24.0, 40);
    let y = even(0.0, 1.5, 2);
    let z = mirrored(&even(0.0, 3.0, 5));
    Case {
        folder: "dcb",
        mesh: block([&x, &y, &z], 0.12),
        crack: vec![sheet([-1.0, -1.0, 0.02], [11.0, 0.0, 0.0], [0.0, 3.5, 0.0])],
    }
}

/// Three-point bend, 260 x 10 x 60 mm, notch of 20 mm that stands at 45 degrees to the beam's axis in the x-y plane.
fn skew_notch() -> Case {
    let x = mirrored(&graded(0.0, 12.0, 130.0, [4, 7], 1.55));
    let y = even(0.0, 10.0, 4);
    let z = even(0.0, 60.0, 14);
    let c = FRAC_PI_4.cos();
    let reach = 8.0;
    Case {
        folder: "skew_notch",
        mesh: block([&x, &y, &z], 0.12),
        crack: vec![sheet(
            [0.05 - reach * c, 5.0 - reach * c, -2.0],
            [0.0, 0.0, 22.0],
            [2.0 * reach * c, 2.0 * reach * c, 0.0],
        )],
    }
}

/// A crack that a second one meets at right angles.
fn two_sheets() -> Case {
    let x = even(0.0, 10.0, 12);
    let z = even(-5.0, 5.0, 12);
    Case {
        folder: "two_sheets",
        mesh: block([&x, &even(0.0, 5.0, 5), &z], 0.12),
        crack: vec![
            sheet([-1.0, -1.0, 0.03], [6.0, 0.0, 0.0], [0.0, 7.0, 0.0]),
            sheet([2.5, -1.0, 0.2], [0.0, 0.0, -6.2], [0.0, 7.0, 0.0]),
        ],
    }
}

/// Gmsh 2.2, binary; physical volume "body", surfaces "x-", "x+", "y-", "y+", "z-", "z+" by the sides of its box.
fn to_binary_msh(mesh: &TetMesh) -> Vec<u8> {
    let mut out = b"$MeshFormat\n2.2 1 8\n".to_vec();
    let put = |out: &mut Vec<u8>, v: &[i32]| v.iter().for_each(|i| out.extend(i.to_le_bytes()));
    put(&mut out, &[1]);
    let names = ["x-", "x+", "y-", "y+", "z-", "z+"];
    let mut text = "\n$EndMeshFormat\n$PhysicalNames\n7\n".to_owned();
    for (i, name) in names.iter().enumerate() {
        text += &format!("2 {} \"{name}\"\n", i + 1);
    }
    text += &format!(
        "3 7 \"body\"\n$EndPhysicalNames\n$Nodes\n{}\n",
        mesh.nodes().len()
    );
    out.extend(text.bytes());
    for (i, p) in mesh.nodes().iter().enumerate() {
        put(&mut out, &[i as i32 + 1]);
        p.iter().for_each(|c| out.extend(c.to_le_bytes()));
    }
    let sides = sides(mesh);
    let n_elements = mesh.tets().len() + sides.len();
    out.extend(format!("\n$EndNodes\n$Elements\n{n_elements}\n").bytes());
    put(&mut out, &[2, sides.len() as i32, 2]);
    let mut number = 0;
    for (group, face) in &sides {
        number += 1;
        put(&mut out, &[number, *group, *group]);
        put(&mut out, &face.map(|n| n as i32 + 1));
    }
    put(&mut out, &[4, mesh.tets().len() as i32, 2]);
    for tet in mesh.tets() {
        number += 1;
        put(&mut out, &[number, 7, 1]);
        put(&mut out, &tet.map(|n| n as i32 + 1));
    }
    out.extend(b"\n$EndElements\n");
    out
}

/// Boundary faces with the number of the side they lie on, from 1.
fn sides(mesh: &TetMesh) -> Vec<(i32, [u32; 3])> {
    let bounds = mesh.bounds();
    let side = |f: &[u32; 3]| {
        (0..6).find(|s| {
            let (axis, at) = (s / 2, if s % 2 == 0 { bounds.min } else { bounds.max });
            f.iter()
                .all(|n| mesh.nodes()[*n as usize][axis] == at[axis])
        })
    };
    let mut found: Vec<_> = mesh
        .boundary_faces()
        .iter()
        .filter_map(|f| Some((side(f)? as i32 + 1, *f)))
        .collect();
    found.sort_unstable();
    found
}
