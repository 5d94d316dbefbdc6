//! Label volumes: what a segmentation gives, voxel by voxel.
use crate::error::AnatomyError;
use flate2::read::MultiGzDecoder;
use nalgebra::Matrix3;
use osteotome_mechanics::geometry::{Aabb, SignedDistance, Vec3};
use rayon::prelude::*;
use std::io::{BufReader, Read, Take};
use std::path::Path;

/// No volume may have more voxels; each takes a byte.
pub const MAX_VOXELS: u64 = 600_000_000;
/// The part around the labels that are looked for may have at most so many voxels; each takes eight bytes.
const MAX_CROPPED: usize = 80_000_000;
/// No packed file may be larger.
const MAX_BYTES: u64 = 4 << 30;
/// No volume unpacks to more: the largest that is allowed, of doubles, and its header.
const MAX_UNPACKED: u64 = 8 * MAX_VOXELS + (32 << 20);

/// A volume \[mm, LPS\].
#[derive(Clone, Debug, PartialEq)]
pub struct Volume<T> {
    /// Voxels along each axis.
    pub size: [usize; 3],
    /// The value of each voxel, the first axis running fastest.
    pub voxels: Vec<T>,
    /// Where they are.
    pub affine: Affine,
}

/// A segmentation: labels.
pub type LabelVolume = Volume<u8>;

/// What a voxel can hold.
pub trait Voxel: Sized {
    /// From voxel `i`'s value in the file.
    ///
    /// # Errors
    /// What is wrong with it.
    fn of(value: f64, i: usize) -> Result<Self, String>;
}

impl Voxel for u8 {
    fn of(value: f64, i: usize) -> Result<Self, String> {
        label(value, i)
    }
}

/// From voxel numbers to mm, LPS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    axes: Matrix3<f64>,
    inverse: Matrix3<f64>,
    origin: Vec3,
}

impl Affine {
    /// `steps`: from a voxel to its neighbour along each axis; `origin`: middle of the first voxel \[mm\].
    ///
    /// # Errors
    /// What is wrong, if the steps span no volume or a voxel is smaller than 0.01 or larger than 20 mm.
    pub fn new(steps: [Vec3; 3], origin: Vec3) -> Result<Self, String> {
        let axes = Matrix3::from_columns(&steps);
        if !axes.iter().chain(origin.iter()).all(|c| c.is_finite()) {
            return Err("its affine holds a number that is not finite".to_owned());
        }
        let edges = steps.map(|s| s.norm());
        if edges.iter().any(|e| !(0.01..=20.0).contains(e)) {
            return Err(format!(
                "its voxels are {:.4} x {:.4} x {:.4} mm; each edge must be 0.01 to 20 mm",
                edges[0], edges[1], edges[2]
            ));
        }
        let flat = axes.determinant().abs() / edges.iter().product::<f64>();
        let inverse = axes.try_inverse().filter(|_| flat > 0.1);
        let inverse = inverse.ok_or("its affine is skewed so much that voxels are flat")?;
        Ok(Self {
            axes,
            inverse,
            origin,
        })
    }

    /// Voxel numbers, with fractions, of a place.
    pub fn index(&self, place: &Vec3) -> Vec3 {
        self.inverse * (place - self.origin)
    }

    /// Place of a voxel's middle.
    pub fn place(&self, index: &Vec3) -> Vec3 {
        self.axes * index + self.origin
    }

    /// Volume of a voxel \[mm3\].
    pub fn voxel(&self) -> f64 {
        self.axes.determinant().abs()
    }

    /// Edges of a voxel \[mm\].
    pub fn edges(&self) -> Vec3 {
        Vec3::from_fn(|k, _| self.axes.column(k).norm())
    }
}

/// How a voxel is written.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum Sample {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Sample {
    fn width(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    fn value(self, bytes: &[u8], is_big: bool) -> f64 {
        let width = self.width();
        let mut word = [0u8; 8];
        word[..width].copy_from_slice(bytes);
        if is_big {
            word[..width].reverse();
        }
        let [a, b, c, d, ..] = word;
        match self {
            Self::I8 => f64::from(a.cast_signed()),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::I64 => i64::from_le_bytes(word) as f64,
            Self::U64 => u64::from_le_bytes(word) as f64,
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(word),
        }
    }
}

/// Refuses a volume beyond [`MAX_VOXELS`].
pub(crate) fn check_size(size: &[usize; 3], name: &str) -> Result<(), AnatomyError> {
    let n = size.iter().fold(1u64, |n, s| n.saturating_mul(*s as u64));
    if n > MAX_VOXELS {
        return Err(AnatomyError::TooLarge {
            what: format!("{name} (voxels)"),
            size: n,
            limit: MAX_VOXELS,
        });
    }
    Ok(())
}

/// A file as a stream, unpacked if it is gzip; never longer than the largest volume.
pub(crate) enum Source {
    Plain(Take<BufReader<std::fs::File>>),
    Packed(Box<Take<MultiGzDecoder<BufReader<std::fs::File>>>>),
}

impl Source {
    pub(crate) fn open(path: &Path) -> Result<Self, AnatomyError> {
        let is_packed = crate::input::beginning(path)?.starts_with(&[0x1f, 0x8b]);
        let plain = Self::open_packed(path)?;
        match plain {
            Self::Plain(file) if is_packed => Ok(Self::Packed(Box::new(
                MultiGzDecoder::new(file.into_inner()).take(MAX_UNPACKED),
            ))),
            other => Ok(other),
        }
    }

    /// The file as it is.
    pub(crate) fn open_packed(path: &Path) -> Result<Self, AnatomyError> {
        let file = crate::input::open_limited(path, MAX_BYTES)?;
        Ok(Self::Plain(BufReader::new(file).take(MAX_UNPACKED)))
    }
}

impl Read for Source {
    fn read(&mut self, to: &mut [u8]) -> std::io::Result<usize> {
        match self {
            Self::Plain(file) => file.read(to),
            Self::Packed(file) => file.read(to),
        }
    }
}

/// What unpacks from a stream, never more than the largest volume.
pub(crate) fn bounded_gunzip(stream: &mut dyn Read) -> impl Read + '_ {
    MultiGzDecoder::new(stream).take(MAX_UNPACKED)
}

impl<T: Voxel> Volume<T> {
    /// Reads exactly the voxels of `size`, each as `sample` and times `scale[0]` plus `scale[1]`.
    pub(crate) fn read(
        stream: &mut dyn Read,
        size: [usize; 3],
        sample: Sample,
        is_big: bool,
        scale: [f64; 2],
        affine: Affine,
    ) -> Result<Self, String> {
        let n = size.iter().product::<usize>();
        let width = sample.width();
        let mut voxels = Vec::new();
        let mut row = vec![0u8; size[0] * width];
        for _ in 0..n / size[0] {
            stream.read_exact(&mut row).map_err(|e| {
                let what = match e.kind() {
                    std::io::ErrorKind::UnexpectedEof => "the file is truncated".to_owned(),
                    _ => e.to_string(),
                };
                format!(
                    "{n} voxels are announced, but only {} can be read: {what}",
                    voxels.len()
                )
            })?;
            for bytes in row.chunks_exact(width) {
                let value = scale[0] * sample.value(bytes, is_big) + scale[1];
                voxels.push(T::of(value, voxels.len())?);
            }
        }
        Ok(Self {
            size,
            voxels,
            affine,
        })
    }

    /// As [`read`](Self::read), from numbers in words.
    pub(crate) fn read_text(
        stream: &mut dyn Read,
        size: [usize; 3],
        affine: Affine,
    ) -> Result<Self, String> {
        let n = size.iter().product::<usize>();
        let mut text = String::new();
        // A label and a blank are at most five letters wide; some more for line ends.
        let limit = 8 * n as u64 + 64;
        stream
            .take(limit)
            .read_to_string(&mut text)
            .map_err(|e| e.to_string())?;
        let mut voxels = Vec::new();
        for word in text.split_ascii_whitespace().take(n) {
            let value = word.parse();
            let value: f64 = value.map_err(|_| format!("\"{word:.20}\" is not a number"))?;
            voxels.push(T::of(value, voxels.len())?);
        }
        if voxels.len() < n {
            let have = voxels.len();
            return Err(format!(
                "{n} voxels are announced, but only {have} are there; the file is truncated"
            ));
        }
        Ok(Self {
            size,
            voxels,
            affine,
        })
    }
}

impl LabelVolume {
    /// How many voxels have each label.
    pub fn counts(&self) -> [usize; 256] {
        let mut counts = [0; 256];
        for v in &self.voxels {
            counts[usize::from(*v)] += 1;
        }
        counts
    }

    /// Voxel numbers of a place in the list.
    pub fn index(&self, i: usize) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        [i % nx, i / nx % ny, i / (nx * ny)]
    }

    /// Middle of a voxel \[mm\].
    pub fn place(&self, i: usize) -> Vec3 {
        self.affine
            .place(&Vec3::from(self.index(i).map(|k| k as f64)))
    }

    /// Shares of a set of labels, smoothed; `None` if no voxel has any of them.
    ///
    /// # Errors
    /// [`AnatomyError::TooLarge`] if the part of the volume that they take is beyond the limits.
    pub fn field(&self, labels: &[u8], name: &str) -> Result<Option<LabelField>, AnatomyError> {
        let mut of_interest = [false; 256];
        labels
            .iter()
            .for_each(|l| of_interest[usize::from(*l)] = true);
        let is_in = |i: usize| of_interest[usize::from(self.voxels[i])];
        self.mask_field(&is_in, name)
    }

    /// As [`field`](Self::field), of any voxels.
    pub(crate) fn mask_field(
        &self,
        is_in: &dyn Fn(usize) -> bool,
        name: &str,
    ) -> Result<Option<LabelField>, AnatomyError> {
        let (mut low, mut high, mut n) = ([usize::MAX; 3], [0; 3], 0);
        for i in (0..self.voxels.len()).filter(|i| is_in(*i)) {
            let at = self.index(i);
            low = [0, 1, 2].map(|k| low[k].min(at[k]));
            high = [0, 1, 2].map(|k| high[k].max(at[k]));
            n += 1;
        }
        if n == 0 {
            return Ok(None);
        }
        let size = [0, 1, 2].map(|k| high[k] - low[k] + 1 + 2 * RIM);
        let cropped = size.iter().product::<usize>();
        if cropped > MAX_CROPPED {
            return Err(AnatomyError::TooLarge {
                what: format!("{name} (voxels around the labels)"),
                size: cropped as u64,
                limit: MAX_CROPPED as u64,
            });
        }
        let mut values = vec![0.0f32; cropped];
        for i in (0..self.voxels.len()).filter(|i| is_in(*i)) {
            let at = self.index(i);
            let [x, y, z] = [0, 1, 2].map(|k| at[k] - low[k] + RIM);
            values[(z * size[1] + y) * size[0] + x] = 1.0;
        }
        let first = Vec3::from_fn(|k, _| low[k] as f64 - RIM as f64);
        let affine = Affine {
            origin: self.affine.place(&first),
            ..self.affine
        };
        Ok(Some(LabelField::new(affine, size, values, n)))
    }
}

/// Empty voxels kept around the labels, so that the surface closes where they touch the volume's border.
const RIM: usize = 4;

/// A voxel's label; `i`: which voxel.
fn label(value: f64, i: usize) -> Result<u8, String> {
    if (0.0..=255.0).contains(&value) && (value - value.round()).abs() < 1e-3 {
        Ok(value.round() as u8)
    } else {
        Err(format!(
            "voxel {i} is {value}; labels are whole numbers from 0 to 255 (a scan cannot be used, only its segmentation)"
        ))
    }
}

/// A region of a label volume with a smooth surface: the labels' indicator, blurred, at the level that keeps the number of voxels.
pub struct LabelField {
    affine: Affine,
    size: [usize; 3],
    values: Vec<f32>,
    /// Of the surface.
    level: f32,
    /// What the voxels hold \[mm3\].
    pub volume: f64,
}

/// Standard deviation of the blur, in voxels: enough that steps vanish.
const BLUR: f64 = 0.9;

impl LabelField {
    fn new(affine: Affine, size: [usize; 3], mut values: Vec<f32>, n: usize) -> Self {
        for axis in 0..3 {
            blur(&mut values, &size, axis);
        }
        let mut sorted: Vec<f32> = values.iter().copied().filter(|v| *v > 0.05).collect();
        // As many voxels lie above the level as had the label.
        let level = if sorted.len() > n {
            *sorted.select_nth_unstable_by(n, |a, b| b.total_cmp(a)).1
        } else {
            0.5
        };
        Self {
            volume: n as f64 * affine.voxel(),
            level: level.clamp(0.3, 0.7),
            affine,
            size,
            values,
        }
    }

    /// Edges of a voxel \[mm\].
    pub fn edges(&self) -> Vec3 {
        self.affine.edges()
    }

    fn at(&self, x: usize, y: usize, z: usize) -> f64 {
        f64::from(self.values[(z * self.size[1] + y) * self.size[0] + x])
    }
}

/// Below zero inside; only its sign and its zeros mean anything.
impl SignedDistance for LabelField {
    fn signed(&self, p: &Vec3) -> f64 {
        let q = self.affine.inverse * (p - self.affine.origin);
        let base = q.map(f64::floor);
        let outside = (0..3).any(|k| base[k] < 0.0 || base[k] + 1.0 >= self.size[k] as f64);
        let scale = self.edges().mean();
        if outside {
            return f64::from(self.level) * scale;
        }
        let f = q - base;
        let [x, y, z] = [0, 1, 2].map(|k| base[k] as usize);
        let line = |y: usize, z: usize| self.at(x, y, z) * (1.0 - f.x) + self.at(x + 1, y, z) * f.x;
        let plane = |z: usize| line(y, z) * (1.0 - f.y) + line(y + 1, z) * f.y;
        let value = plane(z) * (1.0 - f.z) + plane(z + 1) * f.z;
        (f64::from(self.level) - value) * scale
    }

    fn bounds(&self) -> Aabb {
        let last = self.size.map(|n| n as f64 - 1.0);
        let corner = |i: usize| Vec3::from_fn(|k, _| if i >> k & 1 == 1 { last[k] } else { 0.0 });
        let corners: Vec<Vec3> = (0..8).map(|i| self.affine.place(&corner(i))).collect();
        Aabb::around(&corners)
    }
}

/// Blurs along one axis by a normal distribution.
fn blur(values: &mut Vec<f32>, size: &[usize; 3], axis: usize) {
    const REACH: isize = 3;
    let weight = |d: isize| (-0.5 * (d as f64 / BLUR).powi(2)).exp();
    let total: f64 = (-REACH..=REACH).map(weight).sum();
    let weights: Vec<f32> = (-REACH..=REACH)
        .map(|d| (weight(d) / total) as f32)
        .collect();
    let stride = [1, size[0], size[0] * size[1]][axis];
    let n = size[axis] as isize;
    let source = &*values;
    *values = (0..source.len())
        .into_par_iter()
        .map(|i| {
            let at = (i / stride % size[axis]) as isize;
            (-REACH..=REACH)
                .filter(|d| (0..n).contains(&(at + d)))
                .map(|d| {
                    let from = i as isize + d * stride as isize;
                    weights[(d + REACH) as usize] * source[from as usize]
                })
                .sum()
        })
        .collect();
}
