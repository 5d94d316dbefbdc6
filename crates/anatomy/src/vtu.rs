//! VTK's XML unstructured grids (.vtu): linear tetrahedra, written as text, base64 or appended, compressed by zlib or not.
use crate::error::AnatomyError;
use crate::msh::{MeshFile, PhysicalGroup};
use crate::stl::read_limited;
use osteotome_mechanics::geometry::{TetMesh, Vec3};
use std::path::Path;

const MAX_BYTES: u64 = 4 << 30;
const MAX_ITEMS: usize = 50_000_000;
/// Integer cell arrays that say which region a cell belongs to; the first one that is there counts.
const REGION_ARRAYS: [&str; 3] = ["gmsh:physical", "region", "material"];

/// Reads a .vtu file with one piece of little-endian data.
///
/// Vertices, lines and triangles among the cells are passed over; any other cell that is not a linear tetrahedron is refused.
/// A region's name is its number in the cell array `gmsh:physical`, `region` or `material`; there are no named surfaces.
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, truncated, written otherwise, or whose tetrahedra are not usable.
pub fn read_vtu(path: &Path) -> Result<MeshFile, AnatomyError> {
    let bytes = read_limited(path, MAX_BYTES)?;
    parse_vtu(&bytes, &path.display().to_string())
}

/// Parses a .vtu file from memory; `name` is for error texts.
///
/// # Errors
/// As [`read_vtu`].
pub fn parse_vtu(bytes: &[u8], name: &str) -> Result<MeshFile, AnatomyError> {
    let bad = |reason: String| AnatomyError::Format {
        path: name.to_owned(),
        format: "VTK .vtu",
        reason,
    };
    let document = Document::scan(bytes).map_err(bad)?;
    let grid = Grid::read(&document).map_err(bad)?;
    grid.into_mesh(name, bad)
}

/// A mesh as .vtu, exact to the last bit (appended raw data). Read again it is the same if its nodes are in the order of first use.
pub fn to_vtu(mesh: &TetMesh) -> Vec<u8> {
    let n_tets = mesh.tets().len() as u32;
    let blocks: [Vec<u8>; 4] = [
        mesh.nodes()
            .iter()
            .flat_map(|p| [p.x, p.y, p.z])
            .flat_map(f64::to_le_bytes)
            .collect(),
        mesh.tets()
            .iter()
            .flatten()
            .flat_map(|n| n.to_le_bytes())
            .collect(),
        (1..=n_tets).flat_map(|k| (4 * k).to_le_bytes()).collect(),
        vec![10; n_tets as usize],
    ];
    let mut offset = 0;
    let mut starts = blocks.iter().map(|b| {
        let start = offset;
        offset += 8 + b.len();
        start
    });
    let mut array = |attributes: &str| {
        let start = starts.next().unwrap_or(0);
        format!("<DataArray {attributes} format=\"appended\" offset=\"{start}\"/>\n")
    };
    let points = array("type=\"Float64\" Name=\"Points\" NumberOfComponents=\"3\"");
    let cells = [
        array("type=\"UInt32\" Name=\"connectivity\""),
        array("type=\"UInt32\" Name=\"offsets\""),
        array("type=\"UInt8\" Name=\"types\""),
    ]
    .concat();
    let mut out = format!(
        "<?xml version=\"1.0\"?>\n<!-- mm, LPS -->\n\
         <VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
         <UnstructuredGrid>\n<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{n_tets}\">\n\
         <Points>\n{points}</Points>\n<Cells>\n{cells}</Cells>\n\
         </Piece>\n</UnstructuredGrid>\n<AppendedData encoding=\"raw\">\n_",
        mesh.nodes().len()
    )
    .into_bytes();
    for block in &blocks {
        out.extend((block.len() as u64).to_le_bytes());
        out.extend(block);
    }
    out.extend(b"\n</AppendedData>\n</VTKFile>\n");
    out
}

type Parsed<T> = Result<T, String>;

struct Grid {
    points: Vec<Vec3>,
    tets: Vec<[u32; 4]>,
    /// Region of each tetrahedron, if the file says.
    regions: Option<Vec<i32>>,
}

impl Grid {
    fn read(d: &Document) -> Parsed<Self> {
        let (n_points, n_cells) = (d.count("NumberOfPoints")?, d.count("NumberOfCells")?);
        let xyz = d.values("Points", None, 3 * n_points)?;
        let points = xyz
            .chunks_exact(3)
            .map(|c| Vec3::new(c[0], c[1], c[2]))
            .collect();
        let types = d.values("Cells", Some("types"), n_cells)?;
        let ends = d.values("Cells", Some("offsets"), n_cells)?;
        let n_corners = ends.last().copied().unwrap_or(0.0) as usize;
        let corners = d.values("Cells", Some("connectivity"), limited(n_corners)?)?;
        let region_of = REGION_ARRAYS
            .iter()
            .find(|a| d.array("CellData", Some(a)).is_some())
            .map(|a| d.values("CellData", Some(a), n_cells))
            .transpose()?;
        let (mut tets, mut regions) = (Vec::new(), Vec::new());
        let mut begin = 0;
        for (c, (kind, end)) in types.iter().zip(&ends).enumerate() {
            let end = *end as usize;
            let nodes = corners.get(begin..end).ok_or_else(|| {
                format!("cell {c} ends at place {end} of the connectivity, before it begins or beyond its end")
            })?;
            begin = end;
            if !is_tetrahedron(c, *kind, nodes.len())? {
                continue;
            }
            if let Some(n) = nodes.iter().find(|n| **n < 0.0 || **n >= n_points as f64) {
                return Err(format!(
                    "cell {c} names point {n}, but there are only {n_points} points"
                ));
            }
            tets.push([0, 1, 2, 3].map(|k| nodes[k] as u32));
            regions.extend(region_of.as_ref().map(|r| r[c] as i32));
        }
        Ok(Self {
            points,
            tets,
            regions: region_of.map(|_| regions),
        })
    }

    fn into_mesh(
        self,
        name: &str,
        bad: impl Fn(String) -> AnatomyError,
    ) -> Result<MeshFile, AnatomyError> {
        if self.tets.is_empty() {
            return Err(bad(
                "it holds no linear tetrahedra (cell type 10)".to_owned()
            ));
        }
        let mut used = vec![u32::MAX; self.points.len()];
        let mut nodes = Vec::new();
        let mut place = |i: u32| {
            let slot = &mut used[i as usize];
            if *slot == u32::MAX {
                *slot = nodes.len() as u32;
                nodes.push(self.points[i as usize]);
            }
            *slot
        };
        let tets = self.tets.iter().map(|t| t.map(&mut place)).collect();
        let mesh = TetMesh::new(nodes, tets).map_err(|source| AnatomyError::Mesh {
            name: name.to_owned(),
            source,
        })?;
        let regions = self.regions.unwrap_or_default();
        let mut ids = regions.clone();
        ids.sort_unstable();
        ids.dedup();
        let index = |r: &i32| ids.binary_search(r).ok().map(|i| i as u32);
        let mut tet_volume: Vec<_> = regions.iter().map(index).collect();
        tet_volume.resize(mesh.tets().len(), None);
        let group = |id: &i32| PhysicalGroup {
            id: *id,
            name: id.to_string(),
        };
        Ok(MeshFile {
            mesh,
            volumes: ids.iter().map(group).collect(),
            tet_volume,
            surfaces: Vec::new(),
        })
    }
}

/// Whether a cell of VTK's type `kind` is a tetrahedron; `false` for what a body's surface consists of.
fn is_tetrahedron(cell: usize, kind: f64, n_nodes: usize) -> Parsed<bool> {
    match kind as i64 {
        10 if n_nodes == 4 => Ok(true),
        10 => Err(format!("cell {cell} is a tetrahedron of {n_nodes} points")),
        1 | 2 | 3 | 4 | 5 | 7 | 9 => Ok(false),
        other => {
            let word = match other {
                12 => " (hexahedron)",
                13 => " (wedge)",
                14 => " (pyramid)",
                24 => " (quadratic tetrahedron)",
                _ => "",
            };
            Err(format!(
                "cell {cell} is of type {other}{word}; only linear tetrahedra (type 10) can be used"
            ))
        }
    }
}

fn limited(n: usize) -> Parsed<usize> {
    if n <= 4 * MAX_ITEMS {
        Ok(n)
    } else {
        Err(format!("a count of {n} is beyond the limit of {MAX_ITEMS}"))
    }
}

/// One `DataArray`: where it stands and how it is written.
struct Array<'a> {
    section: String,
    name: String,
    kind: String,
    format: String,
    offset: usize,
    text: &'a [u8],
}

/// The file cut into its arrays, nothing decoded yet.
struct Document<'a> {
    wide_header: bool,
    compressed: bool,
    piece: Vec<(String, String)>,
    arrays: Vec<Array<'a>>,
    appended: &'a [u8],
    appended_is_base64: bool,
}

impl<'a> Document<'a> {
    fn scan(bytes: &'a [u8]) -> Parsed<Self> {
        let mut d = Document {
            wide_header: false,
            compressed: false,
            piece: Vec::new(),
            arrays: Vec::new(),
            appended: &[],
            appended_is_base64: false,
        };
        let mut is_vtk = false;
        let mut section = String::new();
        let mut pos = 0;
        while let Some(tag) = Tag::next(bytes, &mut pos)? {
            match tag.name.as_str() {
                "VTKFile" => {
                    is_vtk = true;
                    d.header(&tag)?;
                }
                "Piece" => {
                    if !d.piece.is_empty() {
                        return Err("it holds several pieces; save it as one".to_owned());
                    }
                    d.piece = tag.attributes;
                }
                "Points" | "Cells" | "CellData" | "PointData" => section = tag.name,
                "DataArray" => {
                    let text = if tag.is_empty {
                        &[]
                    } else {
                        until_tag(bytes, &mut pos)
                    };
                    d.arrays.push(Array {
                        section: section.clone(),
                        name: tag.get("Name").to_owned(),
                        kind: tag.get("type").to_owned(),
                        format: tag.get("format").to_owned(),
                        offset: tag.get("offset").parse().unwrap_or(0),
                        text,
                    });
                }
                "AppendedData" => {
                    d.appended_is_base64 = tag.get("encoding") == "base64";
                    let begin = bytes[pos..].iter().position(|b| *b == b'_');
                    let begin = begin.ok_or("the appended data do not begin with _")?;
                    d.appended = &bytes[pos + begin + 1..];
                    break;
                }
                _ => {}
            }
        }
        if !is_vtk {
            return Err("it has no VTKFile element".to_owned());
        }
        Ok(d)
    }

    fn header(&mut self, tag: &Tag) -> Parsed<()> {
        let kind = tag.get("type");
        if kind != "UnstructuredGrid" {
            return Err(format!(
                "it holds \"{kind}\"; an UnstructuredGrid is needed"
            ));
        }
        if tag.get("byte_order") == "BigEndian" {
            return Err("its data are big-endian; save them little-endian".to_owned());
        }
        self.wide_header = tag.get("header_type") == "UInt64";
        self.compressed = match tag.get("compressor") {
            "" => false,
            "vtkZLibDataCompressor" => true,
            other => {
                return Err(format!(
                    "compression by {other} is not supported; save with zlib or without"
                ));
            }
        };
        Ok(())
    }

    fn count(&self, key: &str) -> Parsed<usize> {
        let text = self.piece.iter().find(|a| a.0 == key).map(|a| a.1.trim());
        let n = text
            .and_then(|t| t.parse().ok())
            .ok_or_else(|| format!("its piece has no {key}"))?;
        if n > MAX_ITEMS {
            return Err(format!("{key} of {n} is beyond the limit of {MAX_ITEMS}"));
        }
        Ok(n)
    }

    fn array(&self, section: &str, name: Option<&str>) -> Option<&Array<'a>> {
        let is_it = |a: &&Array| a.section == section && name.is_none_or(|n| a.name == n);
        self.arrays.iter().find(is_it)
    }

    /// The first `n` numbers of an array.
    fn values(&self, section: &str, name: Option<&str>, n: usize) -> Parsed<Vec<f64>> {
        let what = name.unwrap_or(section);
        let array = self
            .array(section, name)
            .ok_or_else(|| format!("it has no array of {what}"))?;
        let values = match array.format.as_str() {
            "ascii" | "" => ascii(array.text, n),
            "binary" => {
                let data = from_base64(array.text)?;
                self.numbers(&data, &array.kind, n)
            }
            "appended" => {
                let rest = self
                    .appended
                    .get(array.offset..)
                    .ok_or("its offset is beyond the appended data")?;
                if self.appended_is_base64 {
                    self.numbers(&from_base64(rest)?, &array.kind, n)
                } else {
                    self.numbers(rest, &array.kind, n)
                }
            }
            other => Err(format!("the format \"{other}\" is not known")),
        };
        let values = values.map_err(|e| format!("array of {what}: {e}"))?;
        if values.len() < n {
            return Err(format!(
                "array of {what}: {n} numbers are announced, but only {} are there; the file is truncated",
                values.len()
            ));
        }
        Ok(values)
    }

    /// Numbers of a binary block with its header.
    fn numbers(&self, data: &[u8], kind: &str, n: usize) -> Parsed<Vec<f64>> {
        let size = width(kind)?;
        let want = n * size;
        let mut pos = 0;
        if !self.compressed {
            let announced = self.header_number(data, &mut pos)?;
            let end = pos.saturating_add(announced.min(want)).min(data.len());
            return Ok(decode(&data[pos..end], kind));
        }
        let blocks = self.header_number(data, &mut pos)?;
        let block_size = self.header_number(data, &mut pos)?;
        self.header_number(data, &mut pos)?;
        if blocks > data.len() {
            return Err(format!("{blocks} compressed blocks are announced"));
        }
        let mut sizes = Vec::new();
        for _ in 0..blocks {
            sizes.push(self.header_number(data, &mut pos)?);
        }
        let mut out = Vec::new();
        for size in sizes {
            let end = pos.checked_add(size).filter(|e| *e <= data.len());
            let end = end.ok_or("the file ends within its compressed data; it is truncated")?;
            let limit = block_size.min(want.saturating_sub(out.len()).saturating_add(64));
            let block =
                miniz_oxide::inflate::decompress_to_vec_zlib_with_limit(&data[pos..end], limit)
                    .map_err(|_| "its compressed data are damaged or longer than announced")?;
            out.extend(block);
            pos = end;
            if out.len() >= want {
                break;
            }
        }
        out.truncate(want);
        Ok(decode(&out, kind))
    }

    fn header_number(&self, data: &[u8], pos: &mut usize) -> Parsed<usize> {
        let n = if self.wide_header { 8 } else { 4 };
        let bytes = data
            .get(*pos..*pos + n)
            .ok_or("the file ends within a header; it is truncated")?;
        *pos += n;
        let mut wide = [0; 8];
        wide[..n].copy_from_slice(bytes);
        usize::try_from(u64::from_le_bytes(wide)).map_err(|e| e.to_string())
    }
}

/// An opening tag.
struct Tag {
    name: String,
    attributes: Vec<(String, String)>,
    is_empty: bool,
}

impl Tag {
    fn get(&self, key: &str) -> &str {
        let found = self.attributes.iter().find(|a| a.0 == key);
        found.map_or("", |a| a.1.as_str())
    }

    /// The next opening tag from `pos` on; closing tags, comments and declarations are passed over.
    fn next(bytes: &[u8], pos: &mut usize) -> Parsed<Option<Self>> {
        loop {
            let Some(open) = bytes[*pos..].iter().position(|b| *b == b'<') else {
                return Ok(None);
            };
            let begin = *pos + open + 1;
            let (skip, ending): (bool, &[u8]) = match bytes.get(begin) {
                Some(b'!') if bytes[begin..].starts_with(b"!--") => (true, b"-->"),
                Some(b'!' | b'?' | b'/') => (true, b">"),
                _ => (false, b">"),
            };
            let end = bytes[begin..]
                .windows(ending.len())
                .position(|w| w == ending)
                .ok_or("a tag does not end; the file is truncated")?;
            *pos = begin + end + ending.len();
            if !skip {
                return Ok(Some(Self::parse(&String::from_utf8_lossy(
                    &bytes[begin..begin + end],
                ))));
            }
        }
    }

    fn parse(text: &str) -> Self {
        let is_empty = text.ends_with('/');
        let text = text.trim_end_matches('/');
        let (name, mut rest) = text
            .split_once(|c: char| c.is_whitespace())
            .unwrap_or((text, ""));
        let mut attributes = Vec::new();
        while let Some((key, after)) = rest.split_once('=') {
            let after = after.trim_start();
            let Some(quote) = after.chars().next().filter(|c| "\"'".contains(*c)) else {
                break;
            };
            let Some((value, more)) = after[1..].split_once(quote) else {
                break;
            };
            attributes.push((key.trim().to_owned(), value.to_owned()));
            rest = more;
        }
        Self {
            name: name.to_owned(),
            attributes,
            is_empty,
        }
    }
}

fn until_tag<'a>(bytes: &'a [u8], pos: &mut usize) -> &'a [u8] {
    let rest = &bytes[*pos..];
    let n = rest.iter().position(|b| *b == b'<').unwrap_or(rest.len());
    *pos += n;
    &rest[..n]
}

fn ascii(text: &[u8], n: usize) -> Parsed<Vec<f64>> {
    let text = String::from_utf8_lossy(text);
    let number = |w: &str| {
        w.parse::<f64>().map_err(|_| {
            let w: String = w.chars().take(40).collect();
            format!("\"{w}\" is not a number")
        })
    };
    text.split_ascii_whitespace().take(n).map(number).collect()
}

/// Decodes base64 up to the first character that does not belong to it; padding may also stand between two parts.
fn from_base64(text: &[u8]) -> Parsed<Vec<u8>> {
    let digit = |b: u8| match b {
        b'A'..=b'Z' => Some(b - b'A'),
        b'a'..=b'z' => Some(b - b'a' + 26),
        b'0'..=b'9' => Some(b - b'0' + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    };
    let mut out = Vec::with_capacity(text.len() / 4 * 3);
    let (mut group, mut count, mut padding) = (0u32, 0, 0);
    for &b in text.iter().filter(|b| !b.is_ascii_whitespace()) {
        match digit(b) {
            Some(_) if padding > 0 => return Err("its base64 data are damaged".to_owned()),
            Some(d) => group = group << 6 | u32::from(d),
            None if b == b'=' && count >= 2 => {
                group <<= 6;
                padding += 1;
            }
            None => break,
        }
        count += 1;
        if count == 4 {
            out.extend_from_slice(&group.to_be_bytes()[1..4 - padding]);
            (group, count, padding) = (0, 0, 0);
        }
    }
    Ok(out)
}

fn width(kind: &str) -> Parsed<usize> {
    Ok(match kind {
        "Int8" | "UInt8" => 1,
        "Int16" | "UInt16" => 2,
        "Int32" | "UInt32" | "Float32" => 4,
        "Int64" | "UInt64" | "Float64" => 8,
        other => return Err(format!("numbers of type \"{other}\" are not supported")),
    })
}

fn decode(data: &[u8], kind: &str) -> Vec<f64> {
    fn each<const N: usize>(data: &[u8], f: impl Fn([u8; N]) -> f64) -> Vec<f64> {
        data.as_chunks::<N>().0.iter().map(|c| f(*c)).collect()
    }
    match kind {
        "Int8" => each::<1>(data, |b| f64::from(i8::from_le_bytes(b))),
        "UInt8" => each::<1>(data, |b| f64::from(b[0])),
        "Int16" => each::<2>(data, |b| f64::from(i16::from_le_bytes(b))),
        "UInt16" => each::<2>(data, |b| f64::from(u16::from_le_bytes(b))),
        "Int32" => each::<4>(data, |b| f64::from(i32::from_le_bytes(b))),
        "UInt32" => each::<4>(data, |b| f64::from(u32::from_le_bytes(b))),
        "Float32" => each::<4>(data, |b| f64::from(f32::from_le_bytes(b))),
        "Int64" => each::<8>(data, |b| i64::from_le_bytes(b) as f64),
        "UInt64" => each::<8>(data, |b| u64::from_le_bytes(b) as f64),
        _ => each::<8>(data, f64::from_le_bytes),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTS: [f64; 15] = [
        0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0,
    ];
    const CORNERS: [i64; 11] = [0, 1, 2, 3, 1, 2, 3, 4, 0, 1, 2];

    fn to_base64(data: &[u8]) -> String {
        const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        let group = |c: &[u8]| {
            let mut b = [0; 4];
            b[1..=c.len()].copy_from_slice(c);
            let v = u32::from_be_bytes(b);
            let digit = |k: usize| char::from(DIGITS[(v >> (18 - 6 * k)) as usize & 63]);
            (0..4)
                .map(|k| if k <= c.len() { digit(k) } else { '=' })
                .collect::<String>()
        };
        data.chunks(3).map(group).collect()
    }

    /// The arrays as raw bytes: points, connectivity, offsets, types, region.
    fn raw() -> [(&'static str, &'static str, Vec<u8>); 5] {
        let ints = |v: &[i64]| v.iter().flat_map(|i| i.to_le_bytes()).collect();
        [
            (
                "Points",
                "Float64",
                POINTS.iter().flat_map(|x| x.to_le_bytes()).collect(),
            ),
            ("connectivity", "Int64", ints(&CORNERS)),
            ("offsets", "Int64", ints(&[4, 8, 11])),
            ("types", "UInt8", vec![10, 10, 5]),
            ("region", "Int64", ints(&[7, 3, 9])),
        ]
    }

    fn document(attributes: &str, array: impl Fn(usize) -> String, tail: &[u8]) -> Vec<u8> {
        let one = |k: usize| {
            let (name, kind, _) = &raw()[k];
            format!("<DataArray type=\"{kind}\" Name=\"{name}\" {}\n", array(k))
        };
        let mut text = format!(
            "<?xml version=\"1.0\"?>\n<!-- a > b -->\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" {attributes}>\n<UnstructuredGrid>\n<Piece NumberOfPoints=\"5\" NumberOfCells=\"3\">\n<Points>\n{}</Points>\n<Cells>\n{}{}{}</Cells>\n<CellData>{}</CellData></Piece></UnstructuredGrid>\n",
            one(0), one(1), one(2), one(3), one(4)
        )
        .into_bytes();
        text.extend_from_slice(tail);
        text.extend_from_slice(b"</VTKFile>\n");
        text
    }

    fn ascii_document() -> Vec<u8> {
        let text = [
            POINTS.map(|x| x.to_string()).join(" "),
            CORNERS.map(|x| x.to_string()).join(" "),
            "4 8 11".to_owned(),
            "10 10 5".to_owned(),
            "7 3 9".to_owned(),
        ];
        document(
            "",
            |k| format!("format=\"ascii\">{}</DataArray>", text[k]),
            b"",
        )
    }

    fn block(k: usize, wide: bool) -> Vec<u8> {
        let data = &raw()[k].2;
        let mut out = if wide {
            (data.len() as u64).to_le_bytes().to_vec()
        } else {
            (data.len() as u32).to_le_bytes().to_vec()
        };
        out.extend(data);
        out
    }

    /// Two blocks, the header padded by itself as VTK does.
    fn zlib(k: usize) -> String {
        let data = &raw()[k].2;
        let half = data.len().div_ceil(2);
        let packed: Vec<Vec<u8>> = data
            .chunks(half)
            .map(|c| miniz_oxide::deflate::compress_to_vec_zlib(c, 6))
            .collect();
        let mut header = vec![packed.len() as u32, half as u32, (data.len() - half) as u32];
        header.extend(packed.iter().map(|p| p.len() as u32));
        let header: Vec<u8> = header.iter().flat_map(|n| n.to_le_bytes()).collect();
        to_base64(&header) + &to_base64(&packed.concat())
    }

    fn appended(base64: bool) -> Vec<u8> {
        let parts: Vec<Vec<u8>> = (0..5)
            .map(|k| {
                let b = block(k, true);
                if base64 {
                    to_base64(&b).into_bytes()
                } else {
                    b
                }
            })
            .collect();
        let offset = |k: usize| parts[..k].iter().map(Vec::len).sum::<usize>();
        let encoding = if base64 { "base64" } else { "raw" };
        let mut tail = format!("<AppendedData encoding=\"{encoding}\">\n _").into_bytes();
        tail.extend(parts.concat());
        tail.extend(b"\n</AppendedData>\n");
        document(
            "header_type=\"UInt64\"",
            |k| format!("format=\"appended\" offset=\"{}\"/>", offset(k)),
            &tail,
        )
    }

    fn all() -> Vec<Vec<u8>> {
        let inline = |text: &dyn Fn(usize) -> String, attributes: &str| {
            document(
                attributes,
                |k| format!("format=\"binary\">\n  {}\n</DataArray>", text(k)),
                b"",
            )
        };
        vec![
            ascii_document(),
            inline(&|k| to_base64(&block(k, false)), ""),
            inline(&zlib, "compressor=\"vtkZLibDataCompressor\""),
            appended(false),
            appended(true),
        ]
    }

    #[test]
    fn all_forms_hold_the_same_mesh() {
        for (i, bytes) in all().iter().enumerate() {
            let file = parse_vtu(bytes, "b.vtu").unwrap_or_else(|e| panic!("form {i}: {e}"));
            assert_eq!(file.mesh.tets(), [[0, 1, 2, 3], [1, 2, 3, 4]], "form {i}");
            assert!((file.mesh.volume() - 0.5).abs() < 1e-15);
            assert_eq!(file.tet_volume, [Some(1), Some(0)]);
            assert_eq!(
                (file.volumes[1].id, file.volumes[1].name.as_str()),
                (7, "7")
            );
        }
    }

    #[test]
    fn no_prefix_of_a_file_panics() {
        for bytes in all() {
            for n in 0..bytes.len() {
                let _ = parse_vtu(&bytes[..n], "b.vtu");
            }
        }
        assert!(parse_vtu(b"", "b.vtu").is_err());
    }

    #[test]
    fn faults_are_told_in_one_line() {
        let text = String::from_utf8(ascii_document()).unwrap();
        let refused = |from: &str, to: &str, part: &str| {
            assert!(text.contains(from), "{from}");
            let error = parse_vtu(text.replace(from, to).as_bytes(), "b.vtu").unwrap_err();
            let error = error.to_string();
            assert!(error.contains(part) && !error.contains('\n'), "{error}");
        };
        refused("10 10 5", "10 12 5", "type 12 (hexahedron)");
        refused("4 8 11", "4 8 99999999999999", "beyond the limit");
        refused("4 8 11", "4 2 11", "before it begins");
        refused("0 1 2 3 1", "0 1 2 77 1", "names point 77");
        refused("0 1 2 3 1", "1 0 2 3 1", "must be positive");
        refused(
            "NumberOfPoints=\"5\"",
            "NumberOfPoints=\"99999999999\"",
            "beyond the limit",
        );
        refused("NumberOfPoints=\"5\"", "NumberOfPoints=\"6\"", "truncated");
        refused("LittleEndian", "BigEndian", "big-endian");
        refused(
            "UnstructuredGrid\" version",
            "PolyData\" version",
            "PolyData",
        );
        refused(
            "type=\"UnstructuredGrid\"",
            "compressor=\"vtkLZ4DataCompressor\" type=\"UnstructuredGrid\"",
            "LZ4",
        );
    }
}
