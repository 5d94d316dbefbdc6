//! DICOM segmentations (PS3.3, A.51 and C.8.20): many frames of one bit a pixel, each of one segment in one plane.
use crate::dicom::{self, Item, Tag};
use crate::error::AnatomyError;
use crate::labels::{Affine, LabelVolume, check_size};
use osteotome_mechanics::geometry::Vec3;
use std::io::Read;
use std::path::Path;

/// No file may be larger: it is held in memory.
const MAX_BYTES: u64 = 512 << 20;
/// Places of frames agree with a lattice within this share of a voxel.
const OFF_LATTICE: f64 = 0.05;
/// Directions agree within this \[rad\].
const SAME_WAY: f64 = 1e-3;

const SOP_CLASS: Tag = (0x0008, 0x0016);
const SLICE_SPACING: Tag = (0x0018, 0x0088);
const SLICE_THICKNESS: Tag = (0x0018, 0x0050);
const POSITION: Tag = (0x0020, 0x0032);
const ORIENTATION: Tag = (0x0020, 0x0037);
const PLANE_POSITION: Tag = (0x0020, 0x9113);
const PLANE_ORIENTATION: Tag = (0x0020, 0x9116);
const FRAMES: Tag = (0x0028, 0x0008);
const ROWS: Tag = (0x0028, 0x0010);
const COLUMNS: Tag = (0x0028, 0x0011);
const PIXEL_SPACING: Tag = (0x0028, 0x0030);
const BITS: Tag = (0x0028, 0x0100);
const PIXEL_MEASURES: Tag = (0x0028, 0x9110);
const KIND: Tag = (0x0062, 0x0001);
const SEGMENT: Tag = (0x0062, 0x000a);
const SEGMENT_NUMBER: Tag = (0x0062, 0x000b);
const SHARED: Tag = (0x5200, 0x9229);
const PER_FRAME: Tag = (0x5200, 0x9230);
const PIXELS: Tag = (0x7fe0, 0x0010);
const SEQUENCES: [Tag; 6] = [
    PLANE_POSITION,
    PLANE_ORIENTATION,
    PIXEL_MEASURES,
    SEGMENT,
    SHARED,
    PER_FRAME,
];

/// Reads a segmentation; each segment's number becomes the label of its voxels, the highest where segments overlap.
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, truncated, too large, compressed, of another kind, or whose frames are no stack.
pub fn read_segmentation(path: &Path) -> Result<LabelVolume, AnatomyError> {
    let name = path.display().to_string();
    let mut bytes = Vec::new();
    let file = crate::input::open_limited(path, MAX_BYTES)?;
    file.take(MAX_BYTES)
        .read_to_end(&mut bytes)
        .map_err(|e| AnatomyError::Read {
            path: name.clone(),
            reason: e.to_string(),
        })?;
    parse_segmentation(&bytes, &name)
}

/// Parses a segmentation; `name` is for error texts.
///
/// # Errors
/// As [`read_segmentation`].
pub fn parse_segmentation(bytes: &[u8], name: &str) -> Result<LabelVolume, AnatomyError> {
    let bad = |reason: String| AnatomyError::Format {
        path: name.to_owned(),
        format: "DICOM segmentation",
        reason,
    };
    let file = dicom::parse(bytes, &SEQUENCES).map_err(bad)?;
    let stack = Stack::read(&file).map_err(bad)?;
    check_size(&stack.size, name)?;
    stack.fill(&file).map_err(bad)
}

type Parsed<T> = Result<T, String>;

/// Frames that make a volume.
struct Stack {
    size: [usize; 3],
    affine: Affine,
    /// Of each frame, its slice and its segment.
    frames: Vec<(usize, u8)>,
}

/// One frame's plane.
#[derive(Clone, Copy)]
struct Plane {
    /// Middle of the first pixel \[mm\].
    at: Vec3,
    /// Along a row and down a column, unit vectors.
    ways: [Vec3; 2],
    /// From column to column and from row to row \[mm\].
    spacing: [f64; 2],
}

impl Stack {
    fn read(file: &Item) -> Parsed<Self> {
        check_kind(file)?;
        let [n] = file.numbers::<1>(FRAMES)?;
        let groups = file.items(PER_FRAME);
        if n < 1.0 || n != groups.len() as f64 {
            return Err(format!(
                "{n} frames are announced, {} are described",
                groups.len()
            ));
        }
        let shared = file.items(SHARED).first();
        let frames: Vec<Frame> = groups.iter().map(|own| Frame { own, shared }).collect();
        let planes = frames.iter().enumerate().map(|(f, frame)| {
            let plane = frame.plane();
            plane.map_err(|e| format!("frame {}: {e}", f + 1))
        });
        let planes: Vec<Plane> = planes.collect::<Parsed<_>>()?;
        let segments = frames.iter().enumerate().map(|(f, frame)| {
            let number = frame
                .group(SEGMENT, SEGMENT_NUMBER)?
                .short(SEGMENT_NUMBER)?;
            let label = u8::try_from(number).ok().filter(|n| *n > 0);
            label.ok_or_else(|| {
                format!(
                    "frame {} is of segment {number}; only 1 to 255 can be used",
                    f + 1
                )
            })
        });
        let segments: Vec<u8> = segments.collect::<Parsed<_>>()?;
        let (first, step, slices) = slices(&planes, frames[0].slice_spacing())?;
        let Plane { ways, spacing, .. } = planes[first];
        let steps = [ways[0] * spacing[0], ways[1] * spacing[1], step];
        let depth = slices.iter().max().map_or(1, |last| last + 1);
        Ok(Self {
            size: [file.short(COLUMNS)?.into(), file.short(ROWS)?.into(), depth],
            affine: Affine::new(steps, planes[first].at)?,
            frames: slices.into_iter().zip(segments).collect(),
        })
    }

    /// Takes the pixels in: bits, the lowest first, frames one right after the other.
    fn fill(&self, file: &Item) -> Parsed<LabelVolume> {
        let [nx, ny, nz] = self.size;
        let (area, pixels) = (nx * ny, file.bytes(PIXELS)?);
        let n_bits = area as u64 * self.frames.len() as u64;
        if area == 0 || (pixels.len() as u64) < n_bits.div_ceil(8) {
            return Err(format!(
                "{} frames of {nx} x {ny} pixels are announced, but only {} bytes are there; the file is truncated",
                self.frames.len(),
                pixels.len()
            ));
        }
        let mut voxels = vec![0u8; area * nz];
        for (f, (slice, label)) in self.frames.iter().enumerate() {
            let to = &mut voxels[slice * area..(slice + 1) * area];
            for (i, voxel) in to.iter_mut().enumerate() {
                let bit = f * area + i;
                if pixels[bit / 8] >> (bit % 8) & 1 == 1 {
                    *voxel = (*voxel).max(*label);
                }
            }
        }
        Ok(LabelVolume {
            size: self.size,
            voxels,
            affine: self.affine,
        })
    }
}

fn check_kind(file: &Item) -> Parsed<()> {
    const SEGMENTATION: &str = "1.2.840.10008.5.1.4.1.1.66.4";
    let class = file.text(SOP_CLASS)?;
    if class != SEGMENTATION {
        return Err(format!(
            "it is an object of class {class:.64}, not a segmentation; a scan cannot be used, only its segmentation"
        ));
    }
    let (kind, bits) = (file.text(KIND)?, file.short(BITS)?);
    if kind != "BINARY" || bits != 1 {
        return Err(format!(
            "it is a {kind:.16} segmentation of {bits} bits a pixel; save it as a binary one"
        ));
    }
    Ok(())
}

/// A frame's own description, and what it shares with all others.
struct Frame<'f, 'a> {
    own: &'f Item<'a>,
    shared: Option<&'f Item<'a>>,
}

impl<'f, 'a> Frame<'f, 'a> {
    /// The group that holds an element.
    fn group(&self, group: Tag, element: Tag) -> Parsed<&'f Item<'a>> {
        let places = [Some(self.own), self.shared];
        let groups = places.into_iter().flatten().flat_map(|i| i.items(group));
        let mut holding = groups.filter(|i| i.has(element));
        let missing = || {
            format!(
                "element ({:04X},{:04X}) is missing, so that its place is unknown",
                element.0, element.1
            )
        };
        holding.next().ok_or_else(missing)
    }

    fn plane(&self) -> Parsed<Plane> {
        let at = self
            .group(PLANE_POSITION, POSITION)?
            .numbers::<3>(POSITION)?;
        let [a, b, c, d, e, f] = self
            .group(PLANE_ORIENTATION, ORIENTATION)?
            .numbers::<6>(ORIENTATION)?;
        let [down, along] = self
            .group(PIXEL_MEASURES, PIXEL_SPACING)?
            .numbers::<2>(PIXEL_SPACING)?;
        let ways = [Vec3::new(a, b, c), Vec3::new(d, e, f)];
        let is_unit = ways.iter().all(|w| (w.norm() - 1.0).abs() < SAME_WAY);
        if !is_unit || ways[0].dot(&ways[1]).abs() > SAME_WAY {
            return Err("its two directions are not of length one and square to each other".into());
        }
        Ok(Plane {
            at: at.into(),
            ways,
            spacing: [along, down],
        })
    }

    /// Between slices, and their thickness \[mm\], where they are said.
    fn slice_spacing(&self) -> [Option<f64>; 2] {
        [SLICE_SPACING, SLICE_THICKNESS].map(|tag| {
            let [spacing] = self.group(PIXEL_MEASURES, tag).ok()?.numbers(tag).ok()?;
            (spacing > 0.0).then_some(spacing)
        })
    }
}

/// The lowest frame, the way from slice to slice, and each frame's slice: planes must be those of one lattice; empty ones may be
/// missing. `said`: what the file says about spacing and thickness.
fn slices(planes: &[Plane], said: [Option<f64>; 2]) -> Parsed<(usize, Vec3, Vec<usize>)> {
    let Plane { ways, spacing, .. } = planes[0];
    let normal = ways[0].cross(&ways[1]);
    let height = |p: &Plane| normal.dot(&p.at);
    let by_height = |a: &usize, b: &usize| height(&planes[*a]).total_cmp(&height(&planes[*b]));
    let first = (0..planes.len()).min_by(by_height).unwrap_or(0);
    let smallest = spacing[0].min(spacing[1]);
    let mut heights: Vec<f64> = planes.iter().map(height).collect();
    heights.sort_unstable_by(f64::total_cmp);
    let gaps = heights.windows(2).map(|w| w[1] - w[0]);
    let gap = gaps
        .filter(|g| *g > OFF_LATTICE * smallest)
        .min_by(f64::total_cmp);
    let [spaced, thick] = said;
    let fits = |s: &f64| gap.is_none_or(|g| (g / s - (g / s).round().max(1.0)).abs() < OFF_LATTICE);
    let nearest = spaced.filter(fits).or(gap).or(thick);
    let nearest = nearest.ok_or("it has one slice, and its thickness is not said")?;
    // The mean over the whole height: differences of written numbers are rounded.
    let whole = heights[heights.len() - 1] - heights[0];
    let n = (whole / nearest).round();
    let step = if n > 0.0 { whole / n } else { nearest };
    let slice = |(f, p): (usize, &Plane)| {
        let way = p.at - planes[first].at;
        let k = (normal.dot(&way) / step).round();
        let off = (way - normal * (k * step)).norm() / smallest;
        let turned = (0..2).any(|i| (p.ways[i] - ways[i]).norm() > SAME_WAY);
        if p.spacing != spacing || turned || off > OFF_LATTICE {
            return Err(format!(
                "frame {} is not in one stack of equal, evenly spaced frames with the first",
                f + 1
            ));
        }
        Ok(k as usize)
    };
    let slices = planes.iter().enumerate().map(slice);
    Ok((first, normal * step, slices.collect::<Parsed<_>>()?))
}
