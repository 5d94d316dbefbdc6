//! DICOM segmentations that the tests write themselves: what is read is what was written, and what is not sound is refused.
use osteotome_anatomy::input::{Shape, read_shape};
use osteotome_anatomy::labels::LabelVolume;
use osteotome_anatomy::segmentation::parse_segmentation;
use osteotome_mechanics::geometry::Vec3;

const IMPLICIT: &str = "1.2.840.10008.1.2";
const EXPLICIT: &str = "1.2.840.10008.1.2.1";
const SEGMENTATION: &str = "1.2.840.10008.5.1.4.1.1.66.4";

/// How a file is written.
#[derive(Clone)]
struct Form {
    syntax: &'static str,
    class: &'static str,
    kind: &'static str,
    /// Sequences and items with their length, or open ended.
    has_lengths: bool,
    /// Where planes have their directions and spacings: in each frame, or shared.
    is_shared: bool,
    bits: u16,
}

const PLAIN: Form = Form {
    syntax: EXPLICIT,
    class: SEGMENTATION,
    kind: "BINARY",
    has_lengths: true,
    is_shared: true,
    bits: 1,
};

struct Frame {
    at: Vec3,
    segment: u16,
    pixels: Vec<bool>,
}

/// A stack to be written.
struct Scan {
    size: [usize; 2],
    ways: [Vec3; 2],
    spacing: [f64; 2],
    /// Said between slices.
    gap: Option<f64>,
    frames: Vec<Frame>,
}

impl Form {
    fn is_explicit(&self) -> bool {
        self.syntax != IMPLICIT
    }

    fn element(&self, group: u16, element: u16, kind: &[u8; 2], value: &[u8]) -> Vec<u8> {
        let mut out = [group.to_le_bytes(), element.to_le_bytes()].concat();
        let mut value = value.to_vec();
        if value.len() % 2 == 1 {
            value.push(if kind == b"UI" { 0 } else { b' ' });
        }
        let is_open = kind == b"SQ" && !self.has_lengths;
        let length = if is_open {
            u32::MAX
        } else {
            value.len() as u32
        };
        let is_long = [b"OB", b"SQ"].contains(&kind);
        if group == 2 || self.is_explicit() {
            out.extend(kind);
            if is_long {
                out.extend([0, 0]);
            } else {
                out.extend((length as u16).to_le_bytes());
            }
        }
        if is_long || !(group == 2 || self.is_explicit()) {
            out.extend(length.to_le_bytes());
        }
        out.extend(value);
        if is_open {
            out.extend([0xfe, 0xff, 0xdd, 0xe0, 0, 0, 0, 0]);
        }
        out
    }

    fn sequence(&self, group: u16, element: u16, items: &[Vec<u8>]) -> Vec<u8> {
        let item = |inner: &Vec<u8>| {
            let mut out = vec![0xfe, 0xff, 0x00, 0xe0];
            if self.has_lengths {
                out.extend((inner.len() as u32).to_le_bytes());
                out.extend(inner);
            } else {
                out.extend(u32::MAX.to_le_bytes());
                out.extend(inner);
                out.extend([0xfe, 0xff, 0x0d, 0xe0, 0, 0, 0, 0]);
            }
            out
        };
        let all: Vec<u8> = items.iter().flat_map(item).collect();
        self.element(group, element, b"SQ", &all)
    }

    fn numbers(&self, group: u16, element: u16, numbers: &[f64]) -> Vec<u8> {
        let words: Vec<String> = numbers.iter().map(|n| format!("{n:.8}")).collect();
        self.element(group, element, b"DS", words.join("\\").as_bytes())
    }

    /// The group that says how a plane lies, but for its place.
    fn plane(&self, scan: &Scan) -> Vec<u8> {
        let ways: Vec<f64> = scan.ways.iter().flatten().copied().collect();
        let [along, down] = scan.spacing;
        let mut measures = Vec::new();
        if let Some(gap) = scan.gap {
            measures.extend(self.numbers(0x18, 0x88, &[gap]));
        }
        measures.extend(self.numbers(0x28, 0x30, &[down, along]));
        [
            self.sequence(0x20, 0x9116, &[self.numbers(0x20, 0x37, &ways)]),
            self.sequence(0x28, 0x9110, &[measures]),
        ]
        .concat()
    }

    fn write(&self, scan: &Scan) -> Vec<u8> {
        let mut out = vec![0; 128];
        out.extend(b"DICM");
        out.extend(self.element(2, 1, b"OB", &[0, 1]));
        out.extend(self.element(2, 0x10, b"UI", self.syntax.as_bytes()));
        out.extend(self.element(8, 0x16, b"UI", self.class.as_bytes()));
        // Something that nobody asks for, in front: a sequence in a sequence.
        let inner = self.sequence(8, 0x2112, &[self.element(8, 0x104, b"LO", b"none")]);
        out.extend(self.sequence(8, 0x1115, &[inner]));
        let short = |n: usize| (n as u16).to_le_bytes();
        out.extend(self.element(0x28, 8, b"IS", scan.frames.len().to_string().as_bytes()));
        out.extend(self.element(0x28, 0x10, b"US", &short(scan.size[1])));
        out.extend(self.element(0x28, 0x11, b"US", &short(scan.size[0])));
        out.extend(self.element(0x28, 0x100, b"US", &self.bits.to_le_bytes()));
        out.extend(self.element(0x62, 1, b"CS", self.kind.as_bytes()));
        let plane = self.plane(scan);
        let frame = |f: &Frame| {
            let at: Vec<f64> = f.at.iter().copied().collect();
            let number = self.element(0x62, 0x0b, b"US", &f.segment.to_le_bytes());
            let mut group = self.sequence(0x20, 0x9113, &[self.numbers(0x20, 0x32, &at)]);
            if !self.is_shared {
                group.extend(&plane);
            }
            group.extend(self.sequence(0x62, 0x0a, &[number]));
            group
        };
        let shared = if self.is_shared {
            plane.clone()
        } else {
            vec![]
        };
        out.extend(self.sequence(0x5200, 0x9229, &[shared]));
        let frames: Vec<Vec<u8>> = scan.frames.iter().map(frame).collect();
        out.extend(self.sequence(0x5200, 0x9230, &frames));
        let bits: Vec<bool> = scan.frames.iter().flat_map(|f| f.pixels.clone()).collect();
        let byte = |b: &[bool]| (0..b.len()).fold(0u8, |byte, k| byte | u8::from(b[k]) << k);
        let packed: Vec<u8> = bits.chunks(8).map(byte).collect();
        out.extend(self.element(0x7fe0, 0x10, b"OB", &packed));
        out
    }
}

const SIZE: [usize; 3] = [7, 5, 6];

fn ways() -> [Vec3; 3] {
    let x = Vec3::new(0.8, 0.6, 0.0);
    let y = Vec3::new(-0.36, 0.48, 0.8);
    [x, y, x.cross(&y)]
}

/// The label of a voxel: two bodies, and nothing in the second slice.
fn label([i, j, k]: [usize; 3]) -> u8 {
    match (i * 5 + j * 3 + k * 2) % 7 {
        _ if k == 1 => 0,
        0 | 3 => 2,
        5 => 5,
        _ => 0,
    }
}

fn place([i, j, k]: [usize; 3]) -> Vec3 {
    let [x, y, z] = ways();
    Vec3::new(12.5, -30.25, 7.0)
        + x * (0.4 * i as f64)
        + y * (0.5 * j as f64)
        + z * (0.7 * k as f64)
}

/// Frames of both segments, from the top down, those that are empty left out.
fn scan() -> Scan {
    let [x, y, _] = ways();
    let mut frames = Vec::new();
    for segment in [2, 5] {
        for k in (0..SIZE[2]).rev() {
            let places = (0..SIZE[1]).flat_map(|j| (0..SIZE[0]).map(move |i| [i, j, k]));
            let pixels: Vec<bool> = places.map(|p| u16::from(label(p)) == segment).collect();
            if pixels.contains(&true) {
                let at = place([0, 0, k]);
                frames.push(Frame {
                    at,
                    segment,
                    pixels,
                });
            }
        }
    }
    Scan {
        size: [SIZE[0], SIZE[1]],
        ways: [x, y],
        spacing: [0.4, 0.5],
        gap: None,
        frames,
    }
}

fn check(volume: &LabelVolume) {
    assert_eq!(volume.size, SIZE);
    for i in 0..volume.voxels.len() {
        let at = volume.index(i);
        assert_eq!(volume.voxels[i], label(at), "{at:?}");
        assert!((volume.place(i) - place(at)).norm() < 1e-6, "{at:?}");
    }
}

fn refusal(bytes: &[u8]) -> String {
    match parse_segmentation(bytes, "s.dcm") {
        Ok(_) => panic!("it was taken"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn what_was_written_is_read_in_every_form() {
    for syntax in [IMPLICIT, EXPLICIT] {
        for has_lengths in [false, true] {
            for is_shared in [false, true] {
                let form = Form {
                    syntax,
                    has_lengths,
                    is_shared,
                    ..PLAIN
                };
                check(&parse_segmentation(&form.write(&scan()), "s.dcm").unwrap());
            }
        }
    }
    // By its mark, whatever its name.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("IM0001");
    std::fs::write(&path, PLAIN.write(&scan())).unwrap();
    match read_shape(&path).unwrap() {
        Shape::Labels(volume) => check(&volume),
        _ => panic!("no labels"),
    }
}

#[test]
fn empty_slices_are_where_the_spacing_says() {
    let mut every_other = scan();
    every_other.gap = Some(0.7);
    let first = place([0, 0, 0]);
    let is_even = |f: &Frame| (((f.at - first).norm() / 0.7).round() as usize).is_multiple_of(2);
    every_other.frames.retain(is_even);
    let volume = parse_segmentation(&PLAIN.write(&every_other), "s").unwrap();
    assert_eq!(volume.size, [7, 5, 5]);
    let edges = volume.affine.edges();
    assert!((edges - Vec3::new(0.4, 0.5, 0.7)).norm() < 1e-6, "{edges}");
    let filled = (0..volume.voxels.len()).filter(|i| volume.voxels[*i] != 0);
    assert!(filled.map(|i| volume.index(i)[2]).all(|k| k % 2 == 0));
    // One slice alone says nothing of its thickness.
    let mut single = scan();
    single.frames.truncate(1);
    assert!(refusal(&PLAIN.write(&single)).contains("thickness is not said"));
    single.gap = Some(0.7);
    assert_eq!(
        parse_segmentation(&PLAIN.write(&single), "s").unwrap().size,
        [7, 5, 1]
    );
}

#[test]
fn the_higher_segment_has_what_two_share() {
    let mut scan = scan();
    let all = vec![true; SIZE[0] * SIZE[1]];
    scan.frames
        .iter_mut()
        .for_each(|f| f.pixels.clone_from(&all));
    scan.frames.reverse();
    let volume = parse_segmentation(&PLAIN.write(&scan), "s").unwrap();
    let counts = volume.counts();
    assert_eq!((counts[2], counts[5], counts[0]), (0, 5 * 35, 35));
}

#[test]
fn what_is_no_sound_segmentation_is_refused_in_words() {
    let with = |change: &dyn Fn(&mut Form)| {
        let mut form = PLAIN;
        change(&mut form);
        refusal(&form.write(&scan()))
    };
    let said = with(&|f| f.syntax = "1.2.840.10008.1.2.5");
    assert!(
        said.contains("s.dcm is not a usable DICOM segmentation file"),
        "{said}"
    );
    assert!(
        said.contains("compressed or big endian; save it uncompressed"),
        "{said}"
    );
    let said = with(&|f| f.class = "1.2.840.10008.5.1.4.1.1.2");
    assert!(said.contains("a scan cannot be used"), "{said}");
    let said = with(&|f| f.kind = "FRACTIONAL");
    assert!(said.contains("save it as a binary one"), "{said}");
    let said = with(&|f| f.bits = 8);
    assert!(said.contains("8 bits a pixel"), "{said}");

    let of = |change: &dyn Fn(&mut Scan)| {
        let mut scan = scan();
        change(&mut scan);
        refusal(&PLAIN.write(&scan))
    };
    let said = of(&|s| s.frames[2].at += ways()[0]);
    assert!(said.contains("frame 3 is not in one stack"), "{said}");
    let said = of(&|s| s.frames[2].at += ways()[2] * 0.3);
    assert!(said.contains("not in one stack"), "{said}");
    let said = of(&|s| s.frames[1].segment = 300);
    assert!(said.contains("frame 2 is of segment 300"), "{said}");
    let said = of(&|s| s.frames[4].pixels.clear());
    assert!(said.contains("the file is truncated"), "{said}");
    let said = of(&|s| s.ways[1] = s.ways[0]);
    assert!(said.contains("square to each other"), "{said}");
    let said = of(&|s| s.spacing[0] = f64::NAN);
    assert!(said.contains("not 2 numbers"), "{said}");
    // Two frames 10 km apart: a volume of 500 million slices.
    let said = of(&|s| {
        s.gap = Some(0.02);
        s.spacing = [0.02; 2];
        s.frames.truncate(2);
        s.frames[0].at = s.frames[1].at + ways()[2] * 1e7;
    });
    assert!(said.contains("too large"), "{said}");
}

/// Bits flipped and words filled, by a fixed seed: read or refused in a line, never a panic, and no more voxels than announced.
#[test]
fn flipped_bits_end_in_a_volume_or_a_word() {
    let good = PLAIN.write(&scan());
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut below = |n: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as usize % n
    };
    let rounds = if std::env::var_os("OSTEOTOME_LONG").is_some() {
        50_000
    } else {
        2_000
    };
    let mut refused = 0;
    for _ in 0..rounds {
        let mut bad = good.clone();
        for _ in 0..=below(4) {
            let at = 132 + below(good.len() - 132);
            match below(3) {
                0 => bad[at] = [0x00, 0x7f, 0x80, 0xff][below(4)],
                1 => bad.iter_mut().skip(at).take(4).for_each(|b| *b = 0xff),
                _ => bad[at] ^= 1 << below(8),
            }
        }
        match parse_segmentation(&bad, "bad.dcm") {
            Ok(v) => assert_eq!(v.voxels.len(), v.size.iter().product::<usize>()),
            Err(error) => {
                assert!(!error.to_string().contains('\n'), "{error}");
                refused += 1;
            }
        }
    }
    assert!(refused > rounds / 5, "{refused}");
}

/// Lengths that announce what is not there, sequences without end, and a tower of them: in bounded memory, without a panic.
#[test]
fn hostile_files_end_in_a_word() {
    let good = PLAIN.write(&scan());
    for n in 0..good.len() {
        refusal(&good[..n]);
    }
    let head = &good[..132 + 14 + 28];
    let mut huge = head.to_vec();
    huge.extend([
        0xe0, 0x7f, 0x10, 0, b'O', b'B', 0, 0, 0xf0, 0xff, 0xff, 0xff,
    ]);
    assert!(refusal(&huge).contains("4294967280 bytes are announced"));
    let mut tower = head.to_vec();
    for _ in 0..50_000 {
        tower.extend([0x62, 0, 2, 0, b'S', b'Q', 0, 0, 0xff, 0xff, 0xff, 0xff]);
        tower.extend([0xfe, 0xff, 0, 0xe0, 0xff, 0xff, 0xff, 0xff]);
    }
    let said = refusal(&tower);
    assert!(said.contains("nested more than 16 deep"), "{said}");
    // Five million items that hold nothing.
    let mut crumbs = head.to_vec();
    crumbs.extend([0x62, 0, 2, 0, b'S', b'Q', 0, 0, 0xff, 0xff, 0xff, 0xff]);
    crumbs.extend([0xfe, 0xff, 0, 0xe0, 0, 0, 0, 0].repeat(5_000_000));
    let said = refusal(&crumbs);
    assert!(said.contains("more than 4000000 elements"), "{said}");
    let twice = [&good[..], &PLAIN.element(0x62, 1, b"CS", b"BINARY")].concat();
    assert!(refusal(&twice).contains("(0062,0001) is there twice"));
}
