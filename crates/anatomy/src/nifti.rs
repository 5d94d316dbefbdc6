//! NIfTI label volumes (.nii, .nii.gz), versions 1 and 2, either endianness. Header fields: nifti1.h and nifti2.h of the NIfTI
//! Data Format Working Group.
use crate::error::AnatomyError;
use crate::labels::{Affine, Sample, Source, Volume, Voxel, check_size};
use osteotome_mechanics::geometry::Vec3;
use std::io::Read;
use std::path::Path;

/// Reads a volume. NIfTI's axes are RAS; the volume comes back in LPS, mm.
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, truncated, too large, without orientation, or whose voxels are not what is asked for.
pub fn read_nifti<T: Voxel>(path: &Path) -> Result<Volume<T>, AnatomyError> {
    let name = path.display().to_string();
    let mut source = Source::open(path)?;
    parse_nifti(&mut source, &name)
}

/// Parses an unpacked volume from a stream; `name` is for error texts.
///
/// # Errors
/// As [`read_nifti`].
pub fn parse_nifti<T: Voxel>(bytes: &mut dyn Read, name: &str) -> Result<Volume<T>, AnatomyError> {
    let bad = |reason: String| AnatomyError::Format {
        path: name.to_owned(),
        format: "NIfTI",
        reason,
    };
    let header = Header::read(bytes).map_err(bad)?;
    let size = header.size().map_err(bad)?;
    check_size(&size, name)?;
    let sample = header.sample().map_err(bad)?;
    let affine = header.affine().map_err(bad)?;
    header.skip_to_data(bytes).map_err(bad)?;
    let scale = header.scale();
    let is_big = header.is_big;
    Volume::read(bytes, size, sample, is_big, scale, affine).map_err(bad)
}

type Parsed<T> = Result<T, String>;

const SIZE_1: usize = 348;
const SIZE_2: usize = 540;

struct Header {
    bytes: Vec<u8>,
    is_big: bool,
    is_second: bool,
}

impl Header {
    fn read(stream: &mut dyn Read) -> Parsed<Self> {
        let short = |_| "it ends within its header; the file is truncated".to_owned();
        let mut bytes = vec![0; 4];
        stream.read_exact(&mut bytes).map_err(short)?;
        let word = [bytes[0], bytes[1], bytes[2], bytes[3]];
        let sizes = [i32::from_le_bytes(word), i32::from_be_bytes(word)];
        let is_size = |n: i32| n == SIZE_1 as i32 || n == SIZE_2 as i32;
        let is_big = !is_size(sizes[0]);
        let size = sizes[usize::from(is_big)];
        if !is_size(size) {
            return Err(format!(
                "its header begins with {}, where NIfTI-1 has 348 and NIfTI-2 540",
                sizes[0]
            ));
        }
        let is_second = size == SIZE_2 as i32;
        bytes.resize(size as usize, 0);
        stream.read_exact(&mut bytes[4..]).map_err(short)?;
        let magic = if is_second {
            &bytes[4..7]
        } else {
            &bytes[344..347]
        };
        match magic {
            b"n+1" | b"n+2" => {}
            b"ni1" | b"ni2" => {
                return Err("header and voxels are in two files; save it as one .nii".to_owned());
            }
            _ => {
                return Err(
                    "it lacks NIfTI's magic \"n+1\" (Analyze 7.5 cannot be used)".to_owned(),
                );
            }
        }
        Ok(Self {
            bytes,
            is_big,
            is_second,
        })
    }

    fn word<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut word = [0; N];
        word.copy_from_slice(&self.bytes[at..at + N]);
        if self.is_big {
            word.reverse();
        }
        word
    }

    fn short(&self, at: usize) -> i64 {
        i64::from(i16::from_le_bytes(self.word(at)))
    }

    /// A number that is single precision in version 1 and double in version 2.
    fn real(&self, first: usize, second: usize, k: usize) -> f64 {
        if self.is_second {
            f64::from_le_bytes(self.word(second + 8 * k))
        } else {
            f64::from(f32::from_le_bytes(self.word(first + 4 * k)))
        }
    }

    /// A number that is 16 bits wide in version 1 and 32 in version 2.
    fn code(&self, first: usize, second: usize) -> i64 {
        if self.is_second {
            i64::from(i32::from_le_bytes(self.word(second)))
        } else {
            self.short(first)
        }
    }

    fn dim(&self, k: usize) -> i64 {
        if self.is_second {
            i64::from_le_bytes(self.word(16 + 8 * k))
        } else {
            self.short(40 + 2 * k)
        }
    }

    fn size(&self) -> Parsed<[usize; 3]> {
        let n = self.dim(0);
        if !(3..=7).contains(&n) {
            return Err(format!("it has {n} dimensions; a volume has 3"));
        }
        if let Some(k) = (4..=n as usize).find(|k| self.dim(*k) > 1) {
            let reason = format!(
                "dimension {k} has {} entries; save one volume of labels",
                self.dim(k)
            );
            return Err(reason);
        }
        let size = [1, 2, 3].map(|k| self.dim(k));
        if size.iter().any(|n| *n < 1) {
            return Err(format!("its size is {size:?} voxels"));
        }
        Ok(size.map(|n| n as usize))
    }

    fn sample(&self) -> Parsed<Sample> {
        let code = if self.is_second {
            self.short(12)
        } else {
            self.short(70)
        };
        Ok(match code {
            2 => Sample::U8,
            4 => Sample::I16,
            8 => Sample::I32,
            16 => Sample::F32,
            64 => Sample::F64,
            256 => Sample::I8,
            512 => Sample::U16,
            768 => Sample::U32,
            1024 => Sample::I64,
            1280 => Sample::U64,
            other => return Err(format!("voxels of data type {other} cannot be labels")),
        })
    }

    fn scale(&self) -> [f64; 2] {
        let [slope, shift] = [self.real(112, 176, 0), self.real(116, 184, 0)];
        if slope == 0.0 || !slope.is_finite() || !shift.is_finite() {
            [1.0, 0.0]
        } else {
            [slope, shift]
        }
    }

    /// From voxel numbers to mm, LPS.
    fn affine(&self) -> Parsed<Affine> {
        let [qform, sform] = [self.code(252, 344), self.code(254, 348)];
        let pixdim = |k: usize| self.real(76, 104, k);
        let rows: [[f64; 4]; 3] = if sform > 0 {
            [0, 1, 2].map(|r| [0, 1, 2, 3].map(|c| self.real(280 + 16 * r, 400 + 32 * r, c)))
        } else if qform > 0 {
            let [b, c, d] = [0, 1, 2].map(|k| self.real(256, 352, k));
            let a = (1.0 - b * b - c * c - d * d).max(0.0).sqrt();
            let turn = [
                [
                    a * a + b * b - c * c - d * d,
                    2.0 * (b * c - a * d),
                    2.0 * (b * d + a * c),
                ],
                [
                    2.0 * (b * c + a * d),
                    a * a + c * c - b * b - d * d,
                    2.0 * (c * d - a * b),
                ],
                [
                    2.0 * (b * d - a * c),
                    2.0 * (c * d + a * b),
                    a * a + d * d - b * b - c * c,
                ],
            ];
            let handed = if pixdim(0) < 0.0 { -1.0 } else { 1.0 };
            [0, 1, 2].map(|r| {
                [
                    turn[r][0] * pixdim(1),
                    turn[r][1] * pixdim(2),
                    turn[r][2] * pixdim(3) * handed,
                    self.real(268, 376, r),
                ]
            })
        } else {
            return Err(
                "it says nothing about its orientation (qform_code and sform_code are 0); save it with its affine"
                    .to_owned(),
            );
        };
        let units = if self.is_second {
            i32::from_le_bytes(self.word(500))
        } else {
            i32::from(self.bytes[123])
        };
        let mm = match units & 7 {
            1 => 1e3,
            3 => 1e-3,
            _ => 1.0,
        };
        // RAS to LPS.
        let lps = [-mm, -mm, mm];
        let column = |c: usize| Vec3::from_fn(|r, _| lps[r] * rows[r][c]);
        Affine::new([0, 1, 2].map(column), column(3))
    }

    fn skip_to_data(&self, stream: &mut dyn Read) -> Parsed<()> {
        let at = if self.is_second {
            i64::from_le_bytes(self.word(168)) as f64
        } else {
            f64::from(f32::from_le_bytes(self.word(108)))
        };
        let read = self.bytes.len() as f64;
        if !(read..=16e6).contains(&at) {
            return Err(format!("its voxels are said to begin at byte {at}"));
        }
        let extensions = (at - read) as u64;
        let skipped = std::io::copy(&mut stream.take(extensions), &mut std::io::sink());
        match skipped {
            Ok(n) if n == extensions => Ok(()),
            _ => Err("it ends before its voxels; the file is truncated".to_owned()),
        }
    }
}
