//! Label volumes made by voxelising the parametric mandible, written as NIfTI and NRRD in their variants, and read back: the same
//! voxels in the same places, a bone of the right volume, the canal where it was.
use flate2::Compression;
use flate2::write::GzEncoder;
use osteotome_anatomy::input::{Shape, read_shape};
use osteotome_anatomy::labels::LabelVolume;
use osteotome_anatomy::prepare::{PrepareSpec, prepare};
use osteotome_anatomy::{Parameters, ParametricMandible};
use osteotome_mechanics::geometry::{SignedDistance, Vec3};
use rayon::prelude::*;
use std::io::Write;
use std::path::{Path, PathBuf};

const SPACING: f64 = 0.7;

/// Labels as DentalSegmentator writes them, first axis to the left, second to the back, third up.
struct Voxels {
    size: [usize; 3],
    origin: Vec3,
    labels: Vec<u8>,
}

fn distance_to_line(p: &Vec3, line: &[Vec3]) -> f64 {
    line.windows(2)
        .map(|w| {
            let edge = w[1] - w[0];
            let s = ((p - w[0]).dot(&edge) / edge.norm_squared()).clamp(0.0, 1.0);
            (p - w[0] - edge * s).norm()
        })
        .fold(f64::INFINITY, f64::min)
}

fn voxelised() -> Voxels {
    let mandible = ParametricMandible::new(Parameters::default()).unwrap();
    let canals = mandible.canals();
    let bounds = mandible.bounds().grown(8.0);
    let size = [0, 1, 2].map(|k| (bounds.extent()[k] / SPACING) as usize + 1);
    let label = |i: usize| {
        let at = [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])];
        let p = bounds.min + Vec3::from(at.map(|k| k as f64)) * SPACING;
        let bone = mandible.signed(&p);
        if bone < 0.0
            && canals
                .iter()
                .any(|c| distance_to_line(&p, &c.line) < c.radius)
        {
            return 5;
        }
        // As segmentations have it, the tooth goes before the bone.
        if mandible.teeth().iter().any(|t| t.signed(&p) < 0.0) {
            return 4;
        }
        u8::from(bone < 0.0) * 2
    };
    Voxels {
        size,
        origin: bounds.min,
        labels: (0..size.iter().product())
            .into_par_iter()
            .map(label)
            .collect(),
    }
}

/// NIfTI-1 with 16-bit voxels; its axes are RAS.
fn nifti(v: &Voxels, is_big: bool, by_quaternion: bool) -> Vec<u8> {
    let mut h = vec![0u8; 352];
    let mut put = |at: usize, bytes: &[u8]| {
        let mut bytes = bytes.to_vec();
        if is_big {
            bytes.reverse();
        }
        h[at..at + bytes.len()].copy_from_slice(&bytes);
    };
    put(0, &348i32.to_le_bytes());
    put(40, &3i16.to_le_bytes());
    for k in 0..3 {
        put(42 + 2 * k, &(v.size[k] as i16).to_le_bytes());
        put(80 + 4 * k, &(SPACING as f32).to_le_bytes());
    }
    put(70, &4i16.to_le_bytes());
    put(76, &1f32.to_le_bytes());
    put(108, &352f32.to_le_bytes());
    put(123, &[2]);
    let ras = [-v.origin.x, -v.origin.y, v.origin.z].map(|c| c as f32);
    if by_quaternion {
        // Half a turn about z.
        put(252, &1i16.to_le_bytes());
        put(264, &1f32.to_le_bytes());
        (0..3).for_each(|k| put(268 + 4 * k, &ras[k].to_le_bytes()));
    } else {
        put(254, &1i16.to_le_bytes());
        let step = [-SPACING as f32, -SPACING as f32, SPACING as f32];
        for k in 0..3 {
            put(280 + 16 * k + 4 * k, &step[k].to_le_bytes());
            put(280 + 16 * k + 12, &ras[k].to_le_bytes());
        }
    }
    h[344..348].copy_from_slice(b"n+1\0");
    for label in &v.labels {
        let short = i16::from(*label);
        h.extend(if is_big {
            short.to_be_bytes()
        } else {
            short.to_le_bytes()
        });
    }
    h
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(bytes).unwrap();
    packed.finish().unwrap()
}

fn nrrd(v: &Voxels, space: &str, encoding: &str, more: &str) -> Vec<u8> {
    let sign = if space == "LPS" { 1.0 } else { -1.0 };
    let [x, y, z] = v.size;
    let o = v.origin;
    let text = format!(
        "NRRD0004\n# made by a test\ntype: uint8\ndimension: 3\nsizes: {x} {y} {z}\nspace: {space}\n\
         space directions: ({s},0,0) (0,{s},0) (0,0,{SPACING})\nspace origin: ({},{},{})\nencoding: {encoding}\n{more}\n",
        sign * o.x,
        sign * o.y,
        o.z,
        s = sign * SPACING,
    );
    text.into_bytes()
}

fn put(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

fn read(path: &Path) -> LabelVolume {
    match read_shape(path) {
        Ok(Shape::Labels(volume)) => volume,
        Ok(_) => panic!("{} is no label volume", path.display()),
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn every_form_gives_the_same_bone() {
    let base = tempfile::tempdir().unwrap();
    let v = voxelised();
    let with = |mut head: Vec<u8>, data: &[u8]| {
        head.extend(data);
        head
    };
    put(base.path(), "voxels.raw.gz", &gzip(&v.labels));
    let forms = [
        ("le.nii", nifti(&v, false, false)),
        ("be.nii", nifti(&v, true, false)),
        ("q.nii.gz", gzip(&nifti(&v, false, true))),
        ("raw.nrrd", with(nrrd(&v, "LPS", "raw", ""), &v.labels)),
        (
            "gz.nrrd",
            with(
                nrrd(&v, "right-anterior-superior", "gzip", ""),
                &gzip(&v.labels),
            ),
        ),
        (
            "apart.nhdr",
            nrrd(&v, "LPS", "gzip", "data file: voxels.raw.gz\n"),
        ),
    ];
    for (name, bytes) in &forms {
        let volume = read(&put(base.path(), name, bytes));
        assert_eq!(volume.size, v.size, "{name}");
        assert!(volume.voxels == v.labels, "{name}");
        for i in [0, 12_345, v.labels.len() - 1] {
            let want = v.origin + Vec3::from(volume.index(i).map(|k| k as f64)) * SPACING;
            assert!((volume.place(i) - want).norm() < 1e-3, "{name}");
        }
    }
    makes_a_patient(&base.path().join("q.nii.gz"), &v);
    refuses(base.path(), &v);
}

fn makes_a_patient(path: &Path, v: &Voxels) {
    let spec = PrepareSpec {
        nodes: Some(1_500),
        ..PrepareSpec::of(path)
    };
    let made = prepare(&spec, &mut |_, _| {}).unwrap();
    let patient = &made.patient;
    let mandible = ParametricMandible::new(Parameters::default()).unwrap();
    // The bone's voxels, canal and teeth's stumps in the bone included.
    let in_bone = |i: &usize| {
        let at = [
            i % v.size[0],
            i / v.size[0] % v.size[1],
            i / (v.size[0] * v.size[1]),
        ];
        mandible.signed(&(v.origin + Vec3::from(at.map(|k| k as f64)) * SPACING)) < 0.0
    };
    let n = (0..v.labels.len()).filter(in_bone).count();
    let want = n as f64 * SPACING.powi(3);
    let volume = patient.surface.volume();
    assert!(
        (volume / want - 1.0).abs() < 0.02,
        "{volume} instead of {want}"
    );
    let off: Vec<f64> = patient
        .surface
        .vertices
        .iter()
        .map(|p| mandible.signed(p).abs())
        .collect();
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    assert!(mean < 0.25 * SPACING, "{mean} mm off on average");
    for (found, made) in patient.canals.iter().zip(mandible.canals()) {
        assert_eq!(found.side, made.side);
        assert!(!found.is_constructed);
        let inner = &found.line[1..found.line.len() - 1];
        let far = inner.iter().map(|p| distance_to_line(p, &made.line));
        assert!(far.fold(0.0, f64::max) < 0.8);
        assert!(
            (found.radius / made.radius - 1.0).abs() < 0.2,
            "{}",
            found.radius
        );
        let runs_the_same_way = (found.line[0] - made.line[0]).norm();
        assert!(runs_the_same_way < 5.0, "{runs_the_same_way}");
    }
    assert_eq!(patient.canals.len(), 2);
    // Crowns touch, so that some are one piece.
    assert!(!patient.teeth.is_empty());
}

/// A bad file gives one line that holds all of `parts`.
fn refuses(folder: &Path, v: &Voxels) {
    let check = |name: &str, bytes: &[u8], parts: &[&str]| {
        let path = put(folder, name, bytes);
        let text = match prepare(&PrepareSpec::of(&path), &mut |_, _| {}) {
            Ok(_) => panic!("{name} was taken"),
            Err(error) => error.to_string(),
        };
        assert!(!text.contains('\n'), "{text}");
        parts
            .iter()
            .for_each(|p| assert!(text.contains(p), "{name}: {text}"));
    };
    let good = nifti(v, false, false);
    let changed = |at: usize, bytes: &[u8]| {
        let mut bad = good.clone();
        bad[at..at + bytes.len()].copy_from_slice(bytes);
        bad
    };
    check(
        "cut.nii",
        &good[..good.len() / 2],
        &["voxels are announced", "truncated"],
    );
    check("head.nii", &good[..100], &["within its header"]);
    check("cut.nii.gz", &gzip(&good)[..2000], &["cut.nii.gz"]);
    check("no.nii", b"hello, this is no volume of any kind", &["348"]);
    check(
        "pair.nii",
        &changed(344, b"ni1\0"),
        &["save it as one .nii"],
    );
    check("lost.nii", &changed(254, &[0, 0]), &["orientation"]);
    let huge: Vec<u8> = [30_000i16; 3]
        .iter()
        .flat_map(|n| n.to_le_bytes())
        .collect();
    check(
        "bomb.nii.gz",
        &gzip(&changed(42, &huge)),
        &["too large", "voxels"],
    );
    let many = [3_i16, 800, 800, 800].iter().flat_map(|n| n.to_le_bytes());
    check(
        "many.nii.gz",
        &gzip(&changed(40, &many.collect::<Vec<_>>())),
        &["truncated"],
    );
    let mut scan = good.clone();
    scan[5_000..5_002].copy_from_slice(&(-1000i16).to_le_bytes());
    check(
        "scan.nii",
        &scan,
        &["voxel 2324 is -1000", "only its segmentation"],
    );
    let empty = Voxels {
        labels: v
            .labels
            .iter()
            .map(|l| if *l == 2 { 7 } else { *l })
            .collect(),
        ..*v
    };
    check(
        "other.nii",
        &nifti(&empty, false, false),
        &["the labels 4, 5, 7", "--label mandible=N"],
    );
    let text = |from: &str, to: &str| {
        let head = String::from_utf8(nrrd(v, "LPS", "raw", "")).unwrap();
        let mut bytes = head.replace(from, to).into_bytes();
        bytes.extend(&v.labels);
        bytes
    };
    check(
        "space.nrrd",
        &text("space: LPS\n", ""),
        &["orientation is unknown"],
    );
    check("type.nrrd", &text("uint8", "block"), &["\"block\""]);
    check("bz.nrrd", &text("raw", "bzip2"), &["\"bzip2\"", "gzip"]);
    check(
        "nan.nrrd",
        &text("space origin: (", "space origin: (nan,0,0) ("),
        &["space origin"],
    );
    check(
        "small.nrrd",
        &text(&format!("({SPACING},0,0)"), "(0.0001,0,0)"),
        &["0.01 to 20 mm"],
    );
    check(
        "list.nrrd",
        &text("encoding", "data file: LIST\nencoding"),
        &["several files"],
    );
    check(
        "none.nhdr",
        &text("encoding", "data file: none.raw\nencoding"),
        &["none.raw"],
    );
}
