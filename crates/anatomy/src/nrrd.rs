//! NRRD label volumes (.nrrd, .nhdr), raw, gzip or text. Header fields: Teem's definition of NRRD file format.
use crate::error::AnatomyError;
use crate::labels::{Affine, Sample, Source, Volume, Voxel, bounded_gunzip, check_size};
use osteotome_mechanics::geometry::Vec3;
use rustc_hash::FxHashMap;
use std::io::Read;
use std::path::Path;

const MAX_HEADER: usize = 1 << 20;

/// Reads a volume; it comes back in LPS, mm.
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, truncated, too large, without orientation, or whose voxels are not what is asked for.
pub fn read_nrrd<T: Voxel>(path: &Path) -> Result<Volume<T>, AnatomyError> {
    let name = path.display().to_string();
    let folder = path.parent().unwrap_or(Path::new(""));
    parse_nrrd(&mut Source::open(path)?, &name, folder)
}

/// Parses a volume from a stream; `name` is for error texts, a detached data file is looked for in `folder`.
///
/// # Errors
/// As [`read_nrrd`].
pub fn parse_nrrd<T: Voxel>(
    stream: &mut dyn Read,
    name: &str,
    folder: &Path,
) -> Result<Volume<T>, AnatomyError> {
    let bad = |reason: String| AnatomyError::Format {
        path: name.to_owned(),
        format: "NRRD",
        reason,
    };
    let header = Header::read(stream).map_err(bad)?;
    let size = header.size().map_err(bad)?;
    check_size(&size, name)?;
    let sample = header.sample().map_err(bad)?;
    let affine = header.affine().map_err(bad)?;
    let is_big = header.get("endian") == Some("big");
    let mut detached;
    let stream: &mut dyn Read = match header.get("data file") {
        None => stream,
        Some(file) if file == "LIST" || file.contains('%') => {
            let reason = format!("its voxels are in several files (\"{file}\"); save it as one");
            return Err(bad(reason));
        }
        Some(file) => {
            detached = Source::open_packed(&folder.join(file))?;
            &mut detached
        }
    };
    header.skip(stream).map_err(bad)?;
    let scale = [1.0, 0.0];
    match header.get("encoding") {
        Some("raw") => Volume::read(stream, size, sample, is_big, scale, affine),
        Some("gzip" | "gz") => {
            let mut unpacked = bounded_gunzip(stream);
            Volume::read(&mut unpacked, size, sample, is_big, scale, affine)
        }
        Some("ascii" | "text" | "txt") => Volume::read_text(stream, size, affine),
        other => Err(format!(
            "the encoding \"{}\" is not known; save it raw or with gzip",
            other.unwrap_or("")
        )),
    }
    .map_err(bad)
}

type Parsed<T> = Result<T, String>;

struct Header(FxHashMap<String, String>);

impl Header {
    /// Lines up to an empty one, or to the end of a detached header.
    fn read(stream: &mut dyn Read) -> Parsed<Self> {
        let mut fields = FxHashMap::default();
        let (mut line, mut total, mut n_lines) = (Vec::new(), 0, 0);
        loop {
            let mut byte = [0];
            let n = stream.read(&mut byte).map_err(|e| e.to_string())?;
            total += n;
            if total > MAX_HEADER {
                return Err(format!("its header is longer than {MAX_HEADER} bytes"));
            }
            if n == 1 && byte[0] != b'\n' {
                line.push(byte[0]);
                continue;
            }
            let text = String::from_utf8_lossy(&line).trim_end().to_owned();
            if n_lines == 0 && !text.starts_with("NRRD000") {
                return Err("it does not begin with \"NRRD000\"".to_owned());
            }
            if text.is_empty() {
                break;
            }
            if let (false, Some((key, value))) = (text.starts_with('#'), text.split_once(": ")) {
                fields.insert(key.trim().to_lowercase(), value.trim().to_owned());
            }
            if n == 0 {
                break;
            }
            n_lines += 1;
            line.clear();
        }
        // The other spelling.
        if let Some(file) = fields.remove("datafile") {
            fields.insert("data file".to_owned(), file);
        }
        Ok(Self(fields))
    }

    fn get(&self, key: &str) -> Option<&str> {
        self.0.get(key).map(String::as_str)
    }

    fn need(&self, key: &str) -> Parsed<&str> {
        self.get(key)
            .ok_or_else(|| format!("its header has no \"{key}\""))
    }

    /// Sizes along the three axes of space; a first axis of one entry (Slicer's segmentations) is passed over.
    fn size(&self) -> Parsed<[usize; 3]> {
        let sizes: Option<Vec<usize>> = self
            .need("sizes")?
            .split_ascii_whitespace()
            .map(|w| w.parse().ok().filter(|n| *n > 0))
            .collect();
        let sizes = sizes.ok_or("its sizes are no positive numbers")?;
        match sizes[..] {
            [x, y, z] | [1, x, y, z] => Ok([x, y, z]),
            [n, _, _, _] => Err(format!(
                "it has {n} layers; save the segmentation as one label map"
            )),
            _ => Err(format!("it has {} dimensions; a volume has 3", sizes.len())),
        }
    }

    fn sample(&self) -> Parsed<Sample> {
        let name = self.need("type")?;
        Ok(match name {
            "signed char" | "int8" | "int8_t" => Sample::I8,
            "uchar" | "unsigned char" | "uint8" | "uint8_t" => Sample::U8,
            "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => {
                Sample::I16
            }
            "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => {
                Sample::U16
            }
            "int" | "signed int" | "int32" | "int32_t" => Sample::I32,
            "uint" | "unsigned int" | "uint32" | "uint32_t" => Sample::U32,
            "longlong" | "long long" | "int64" | "int64_t" => Sample::I64,
            "ulonglong" | "unsigned long long" | "uint64" | "uint64_t" => Sample::U64,
            "float" => Sample::F32,
            "double" => Sample::F64,
            other => return Err(format!("voxels of type \"{other}\" cannot be labels")),
        })
    }

    fn affine(&self) -> Parsed<Affine> {
        let space = self.need("space").map_err(|e| {
            format!("{e}, so that its orientation is unknown; save it with space and directions")
        })?;
        let signs = match space.to_lowercase().as_str() {
            "left-posterior-superior" | "lps" => [1.0, 1.0, 1.0],
            "right-anterior-superior" | "ras" => [-1.0, -1.0, 1.0],
            "left-anterior-superior" | "las" => [1.0, -1.0, 1.0],
            other => {
                return Err(format!(
                    "the space \"{other}\" is not known; use LPS or RAS"
                ));
            }
        };
        let directions = vectors(self.need("space directions")?)?;
        let origin = vectors(self.need("space origin")?)?;
        let ([x, y, z], [at]) = (&directions[..], &origin[..]) else {
            return Err("it needs three space directions and one space origin".to_owned());
        };
        let lps = |v: &Vec3| v.component_mul(&Vec3::from(signs));
        Affine::new([lps(x), lps(y), lps(z)], lps(at))
    }

    fn skip(&self, stream: &mut dyn Read) -> Parsed<()> {
        let number = |key: &str| match self.get(key) {
            None => Ok(0u64),
            Some(text) => text
                .parse()
                .ok()
                .filter(|n| *n <= 1 << 24)
                .ok_or_else(|| format!("\"{key}: {text}\" cannot be followed")),
        };
        let lines = number("line skip")?;
        for _ in 0..lines {
            let mut byte = [0];
            while stream.read(&mut byte).map_err(|e| e.to_string())? == 1 && byte[0] != b'\n' {}
        }
        let bytes = number("byte skip")?;
        std::io::copy(&mut stream.take(bytes), &mut std::io::sink()).map_err(|e| e.to_string())?;
        Ok(())
    }
}

/// `(1,0,0) none (0,1,0)`: the vectors, without the axes that have none.
fn vectors(text: &str) -> Parsed<Vec<Vec3>> {
    let wrong = || format!("\"{text}\" is no list of vectors");
    text.split_inclusive(')')
        .map(|part| part.trim().trim_start_matches("none").trim())
        .filter(|part| !part.is_empty())
        .map(|part| {
            let inner = part.strip_prefix('(').and_then(|p| p.strip_suffix(')'));
            let numbers: Option<Vec<f64>> = inner
                .ok_or_else(wrong)?
                .split(',')
                .map(|n| n.trim().parse().ok())
                .collect();
            match numbers.as_deref() {
                Some([x, y, z]) => Ok(Vec3::new(*x, *y, *z)),
                _ => Err(wrong()),
            }
        })
        .collect()
}
