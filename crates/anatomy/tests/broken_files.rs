//! Fuzz: every reader, on files that are cut short, have bits flipped, numbers made absurd or pieces doubled, by fixed seeds. It may read
//! or refuse, in one line, but never panic; and it never takes a number that is not finite or a vertex that is not there.
//! `OSTEOTOME_LONG=1`: eighty times as many.
use flate2::{Compression, write::GzEncoder};
use osteotome_anatomy::input::{Shape, read_shape};
use osteotome_anatomy::{canal, landmarks, ply, stl, vtu};
use osteotome_mechanics::geometry::{TriMesh, Vec3, block_mesh};
use std::io::Write;
use std::path::Path;

/// Marsaglia's xorshift.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as usize % n.max(1)
    }
}

fn broken(good: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bad = good.to_vec();
    match random.below(7) {
        0 => bad.truncate(random.below(good.len())),
        1 => {
            let (from, to) = (random.below(bad.len()), random.below(bad.len()));
            bad.drain(from.min(to)..from.max(to));
        }
        2 => {
            // A piece twice, or somewhere else.
            let (from, to) = (random.below(bad.len()), random.below(bad.len()));
            let piece = bad[from.min(to)..from.max(to)].to_vec();
            let at = random.below(bad.len());
            bad.splice(at..at, piece);
        }
        3 => {
            // A number of the text made absurd; in binary files some byte.
            let digits: Vec<usize> = (0..bad.len())
                .filter(|i| bad[*i].is_ascii_digit())
                .collect();
            if let Some(at) = digits.get(random.below(digits.len())) {
                let absurd = [
                    "-1",
                    "0",
                    "99999999999",
                    "4294967296",
                    "1e308",
                    "nan",
                    "-inf",
                    "1e-320",
                ];
                let end = at + bad[*at..].iter().take_while(|b| b.is_ascii_digit()).count();
                bad.splice(*at..end, absurd[random.below(absurd.len())].bytes());
            }
        }
        4 => {
            // All bits of a word of the header: lengths, counts, offsets.
            let at = random.below(400.min(bad.len().saturating_sub(8)));
            let n = [2, 4, 8][random.below(3)];
            let fill = [0x00, 0x7f, 0x80, 0xff][random.below(4)];
            bad.iter_mut().skip(at).take(n).for_each(|b| *b = fill);
        }
        _ => {
            for _ in 0..=random.below(6) {
                // Headers are short: half of the flips go there.
                let reach = if random.below(2) == 0 { 400 } else { bad.len() };
                let at = random.below(reach.min(bad.len()));
                bad[at] ^= 1 << random.below(8);
            }
        }
    }
    bad
}

fn block() -> osteotome_mechanics::geometry::TetMesh {
    block_mesh(Vec3::zeros(), Vec3::repeat(10.0), [2, 2, 2])
}

fn surface() -> TriMesh {
    let mesh = block();
    TriMesh {
        vertices: mesh.nodes().to_vec(),
        triangles: mesh.boundary_faces().to_vec(),
    }
}

fn examples() -> Vec<(&'static str, Vec<u8>)> {
    let mesh = surface();
    let mut text_ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\n\
         property list uchar int vertex_index\nend_header\n",
        mesh.vertices.len(),
        mesh.triangles.len()
    );
    let mut obj = String::new();
    let mut solid = "solid a\n".to_owned();
    for p in &mesh.vertices {
        text_ply += &format!("{} {} {}\n", p.x, p.y, p.z);
        obj += &format!("v {} {} {}\n", p.x, p.y, p.z);
    }
    for t in &mesh.triangles {
        let [a, b, c] = *t;
        text_ply += &format!("3 {a} {b} {c}\n");
        obj += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
        solid += "facet normal 0 0 0\nouter loop\n";
        for v in t {
            let p = mesh.vertices[*v as usize];
            solid += &format!("vertex {} {} {}\n", p.x, p.y, p.z);
        }
        solid += "endloop\nendfacet\n";
    }
    solid += "endsolid a\n";
    let mut msh = format!(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{}\n",
        block().nodes().len()
    );
    for (i, p) in block().nodes().iter().enumerate() {
        msh += &format!("{} {} {} {}\n", i + 1, p.x, p.y, p.z);
    }
    msh += &format!("$EndNodes\n$Elements\n{}\n", block().tets().len());
    for (i, t) in block().tets().iter().enumerate() {
        let [a, b, c, d] = t.map(|n| n + 1);
        msh += &format!("{} 4 2 1 1 {a} {b} {c} {d}\n", i + 1);
    }
    msh += "$EndElements\n";
    let nrrd = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 4 4\nspace: LPS\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n\
                space origin: (0,0,0)\nencoding: raw\n\n";
    let mut nifti = vec![0u8; 352];
    nifti[..4].copy_from_slice(&348i32.to_le_bytes());
    for (k, n) in [3i16, 4, 4, 4].iter().enumerate() {
        nifti[40 + 2 * k..42 + 2 * k].copy_from_slice(&n.to_le_bytes());
    }
    nifti[70] = 2;
    nifti[254] = 1;
    nifti[108..112].copy_from_slice(&352f32.to_le_bytes());
    for k in 0..3 {
        nifti[280 + 20 * k..284 + 20 * k].copy_from_slice(&1f32.to_le_bytes());
    }
    nifti[344..347].copy_from_slice(b"n+1");
    nifti.extend([2u8; 64]);
    let packed = |bytes: &[u8]| {
        let mut to = GzEncoder::new(Vec::new(), Compression::fast());
        to.write_all(bytes).unwrap();
        to.finish().unwrap()
    };
    let nrrd_of = |encoding: &str, data: &[u8]| {
        let head = nrrd.replace("encoding: raw", &format!("encoding: {encoding}"));
        [head.as_bytes(), data].concat()
    };
    let mut msh4 = format!(
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 {n} 1 {n}\n3 1 0 {n}\n",
        n = block().nodes().len()
    );
    (1..=block().nodes().len()).for_each(|i| msh4 += &format!("{i}\n"));
    for p in block().nodes() {
        msh4 += &format!("{} {} {}\n", p.x, p.y, p.z);
    }
    let n = block().tets().len();
    msh4 += &format!("$EndNodes\n$Elements\n1 {n} 1 {n}\n3 1 4 {n}\n");
    for (i, t) in block().tets().iter().enumerate() {
        let [a, b, c, d] = t.map(|n| n + 1);
        msh4 += &format!("{} {a} {b} {c} {d}\n", i + 1);
    }
    msh4 += "$EndElements\n";
    vec![
        ("g.nii.gz", packed(&nifti)),
        ("g.nrrd", nrrd_of("gzip", &packed(&[2u8; 64]))),
        ("a.nrrd", nrrd_of("ascii", "2 ".repeat(64).as_bytes())),
        ("four.msh", msh4.into_bytes()),
        ("b.stl", stl::to_binary_stl(&mesh)),
        ("t.stl", solid.into_bytes()),
        ("b.ply", ply::to_binary_ply(&mesh)),
        ("t.ply", text_ply.into_bytes()),
        ("t.obj", obj.into_bytes()),
        ("t.msh", msh.into_bytes()),
        ("b.vtu", vtu::to_vtu(&block())),
        ("t.nrrd", [nrrd.as_bytes(), &[2u8; 64]].concat()),
        ("b.nii", nifti),
    ]
}

fn is_sound(shape: &Shape) -> bool {
    let finite = |p: &Vec3| p.iter().all(|c| c.is_finite());
    match shape {
        Shape::Surface(mesh) => {
            let n = mesh.vertices.len() as u32;
            mesh.vertices.iter().all(finite) && mesh.triangles.iter().flatten().all(|v| *v < n)
        }
        Shape::Tets(file) => file.mesh.nodes().iter().all(finite) && file.mesh.volume() > 0.0,
        Shape::Labels(v) => v.voxels.len() == v.size.iter().product::<usize>(),
    }
}

#[test]
fn readers_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    for (name, good) in examples() {
        let path = folder.path().join(name);
        std::fs::write(&path, &good).unwrap();
        assert!(read_shape(&path).is_ok_and(|s| is_sound(&s)), "{name}");
        let mut refused = 0;
        let rounds = if std::env::var_os("OSTEOTOME_LONG").is_some() {
            20_000
        } else {
            250
        };
        for _ in 0..rounds {
            std::fs::write(&path, broken(&good, &mut random)).unwrap();
            match read_shape(&path) {
                Ok(shape) => assert!(is_sound(&shape), "{name}"),
                Err(error) => {
                    assert!(!error.to_string().contains('\n'), "{name}: {error}");
                    refused += 1;
                }
            }
        }
        assert!(refused > rounds / 6, "{name}: only {refused} were refused");
    }
}

#[test]
fn json_readers_never_panic() {
    let mut random = Random(7);
    let mandible = osteotome_anatomy::ParametricMandible::new(Default::default()).unwrap();
    let good = serde_json::to_vec(&mandible.canals()[0].to_file()).unwrap();
    let sound = |c: &osteotome_anatomy::Canal| c.line.iter().flatten().all(|x| x.is_finite());
    for _ in 0..2_000 {
        let bad = broken(&good, &mut random);
        assert!(canal::parse_canal(&bad, "c").as_ref().map_or(true, sound));
        let _ = landmarks::parse_landmarks(&bad, "l");
    }
}

#[test]
fn files_of_other_kinds_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let refusal = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        match read_shape(&path) {
            Ok(_) => panic!("{name} was taken"),
            Err(error) => error.to_string(),
        }
    };
    let mut dicom = [0u8; 200];
    dicom[128..132].copy_from_slice(b"DICM");
    for (name, bytes, part) in [
        (
            "jaw.stl",
            &b"\x89PNG\r\n\x1a\n"[..],
            "is a PNG picture; give STL",
        ),
        (
            "jaw.dcm",
            &dicom[..],
            "is not a usable DICOM segmentation file: element (0002,0010) is missing",
        ),
        ("jaw.ply", b"PK\x03\x04...", "ZIP archive"),
        ("jaw.step", b"ISO-10303-21;", "no known ending; give STL"),
        ("jaw.stl", b"", "0 bytes are too few"),
        ("empty.obj", b"", "no triangles"),
    ] {
        let text = refusal(name, bytes);
        assert!(text.contains(part), "{text}");
    }
    let text = match read_shape(Path::new(folder.path())) {
        Ok(_) => panic!("a folder was taken"),
        Err(error) => error.to_string(),
    };
    assert!(text.contains("not a regular file"), "{text}");
}
