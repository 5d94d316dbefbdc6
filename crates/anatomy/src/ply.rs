//! PLY, text and binary of either endianness: vertices and polygons; everything else in the file is passed over.
use crate::error::AnatomyError;
use crate::stl::read_limited;
use crate::surface::{MAX_TRIANGLES, checked_surface};
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use std::path::Path;

const MAX_BYTES: u64 = 4 << 30;
/// No header is longer.
const MAX_HEADER: usize = 64 << 10;
/// No polygon has more corners.
const MAX_CORNERS: u64 = 1_000;

/// Reads a surface \[mm\]; polygons become fans of triangles, vertices stay as they are shared in the file.
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, truncated, too large, or not of this form.
pub fn read_ply(path: &Path) -> Result<TriMesh, AnatomyError> {
    parse_ply(&read_limited(path, MAX_BYTES)?, &path.display().to_string())
}

/// Parses PLY from memory; `name` is for error texts.
///
/// # Errors
/// As [`read_ply`].
pub fn parse_ply(bytes: &[u8], name: &str) -> Result<TriMesh, AnatomyError> {
    let bad = |reason: String| AnatomyError::Format {
        path: name.to_owned(),
        format: "PLY",
        reason,
    };
    let (header, start) = Header::read(bytes).map_err(bad)?;
    let mut numbers = Numbers {
        bytes: &bytes[start..],
        pos: 0,
        coding: header.coding,
    };
    let mut mesh = TriMesh::default();
    for element in &header.elements {
        element.read(&mut numbers, &mut mesh).map_err(bad)?;
    }
    checked_surface(mesh, name, "PLY")
}

/// A surface as binary PLY, exact to the last bit.
pub fn to_binary_ply(mesh: &TriMesh) -> Vec<u8> {
    let mut out = format!(
        "ply\nformat binary_little_endian 1.0\ncomment mm, LPS\nelement vertex {}\nproperty double x\nproperty double y\n\
         property double z\nelement face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.vertices.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    for p in &mesh.vertices {
        out.extend(p.iter().flat_map(|c| c.to_le_bytes()));
    }
    for t in &mesh.triangles {
        out.push(3);
        out.extend(t.iter().flat_map(|v| v.to_le_bytes()));
    }
    out
}

type Parsed<T> = Result<T, String>;

#[derive(Clone, Copy, PartialEq)]
enum Coding {
    Text,
    Little,
    Big,
}

#[derive(Clone, Copy)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn named(name: &str) -> Parsed<Self> {
        Ok(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            other => return Err(format!("the type \"{other}\" of a property is not known")),
        })
    }

    fn width(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

struct Property {
    name: String,
    kind: Kind,
    /// Of the count that goes before a list.
    count: Option<Kind>,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

struct Header {
    coding: Coding,
    elements: Vec<Element>,
}

impl Header {
    /// The header and where the data begin.
    fn read(bytes: &[u8]) -> Parsed<(Self, usize)> {
        let head = &bytes[..bytes.len().min(MAX_HEADER)];
        if !head.starts_with(b"ply") {
            return Err("it does not begin with \"ply\"".to_owned());
        }
        let mark = b"end_header";
        let end = head
            .windows(mark.len())
            .position(|w| w == mark)
            .ok_or("its header has no \"end_header\"")?;
        let line_end = bytes[end..].iter().position(|b| *b == b'\n');
        let start = line_end.map_or(bytes.len(), |n| end + n + 1);
        let text = String::from_utf8_lossy(&head[..end]).into_owned();
        let mut coding = None;
        let mut elements: Vec<Element> = Vec::new();
        for line in text.lines() {
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words[..] {
                ["format", format, _] => {
                    coding = Some(match format {
                        "ascii" => Coding::Text,
                        "binary_little_endian" => Coding::Little,
                        "binary_big_endian" => Coding::Big,
                        other => return Err(format!("the format \"{other}\" is not known")),
                    });
                }
                ["element", name, count] => elements.push(Element {
                    name: name.to_owned(),
                    count: count
                        .parse()
                        .map_err(|_| format!("\"{count}\" is no count of elements"))?,
                    properties: Vec::new(),
                }),
                ["property", "list", count, kind, name] => {
                    push(
                        &mut elements,
                        name,
                        Kind::named(kind)?,
                        Some(Kind::named(count)?),
                    )?;
                }
                ["property", kind, name] => {
                    push(&mut elements, name, Kind::named(kind)?, None)?;
                }
                _ => {}
            }
        }
        let coding = coding.ok_or("its header has no line \"format\"")?;
        Ok((Self { coding, elements }, start))
    }
}

fn push(elements: &mut [Element], name: &str, kind: Kind, count: Option<Kind>) -> Parsed<()> {
    let element = elements
        .last_mut()
        .ok_or("a property stands before any element")?;
    element.properties.push(Property {
        name: name.to_owned(),
        kind,
        count,
    });
    Ok(())
}

struct Numbers<'a> {
    bytes: &'a [u8],
    pos: usize,
    coding: Coding,
}

impl Numbers<'_> {
    fn next(&mut self, kind: Kind) -> Parsed<f64> {
        const SHORT: &str = "it ends before all that its header announces; the file is truncated";
        if self.coding == Coding::Text {
            let rest = &self.bytes[self.pos..];
            let skip = rest.iter().take_while(|b| b.is_ascii_whitespace()).count();
            let word = &rest[skip..];
            let n = word.iter().take_while(|b| !b.is_ascii_whitespace()).count();
            if n == 0 {
                return Err(SHORT.to_owned());
            }
            self.pos += skip + n;
            let text = String::from_utf8_lossy(&word[..n.min(40)]);
            return text
                .parse()
                .map_err(|_| format!("\"{text}\" is not a number"));
        }
        let width = kind.width();
        let bytes = self.bytes.get(self.pos..self.pos + width).ok_or(SHORT)?;
        self.pos += width;
        // Little-endian, lowest byte first.
        let mut word = [0u8; 8];
        word[..width].copy_from_slice(bytes);
        if self.coding == Coding::Big {
            word[..width].reverse();
        }
        let [a, b, c, d, ..] = word;
        Ok(match kind {
            Kind::I8 => f64::from(a.cast_signed()),
            Kind::U8 => f64::from(a),
            Kind::I16 => f64::from(i16::from_le_bytes([a, b])),
            Kind::U16 => f64::from(u16::from_le_bytes([a, b])),
            Kind::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Kind::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Kind::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Kind::F64 => f64::from_le_bytes(word),
        })
    }
}

impl Element {
    fn read(&self, numbers: &mut Numbers, mesh: &mut TriMesh) -> Parsed<()> {
        let place = |name: &str| self.properties.iter().position(|p| p.name == name);
        let xyz = [place("x"), place("y"), place("z")];
        let is_vertex = self.name == "vertex";
        if is_vertex && xyz.contains(&None) {
            return Err("its vertices have no x, y and z".to_owned());
        }
        let corners = place("vertex_indices").or_else(|| place("vertex_index"));
        let is_face = self.name == "face" && corners.is_some();
        let limit = MAX_TRIANGLES as u64;
        if (is_vertex || is_face) && self.count > limit {
            let (n, name) = (self.count, &self.name);
            return Err(format!(
                "{n} elements \"{name}\"; at most {limit} can be used"
            ));
        }
        if self.properties.is_empty() {
            return Ok(());
        }
        let mut values = vec![0.0; self.properties.len()];
        let mut polygon = Vec::new();
        for _ in 0..self.count {
            for (k, property) in self.properties.iter().enumerate() {
                let Some(count) = property.count else {
                    values[k] = numbers.next(property.kind)?;
                    continue;
                };
                let n = numbers.next(count)?;
                if !(0.0..=MAX_CORNERS as f64).contains(&n) {
                    return Err(format!("a list of {n}; at most {MAX_CORNERS} can be used"));
                }
                let is_polygon = is_face && Some(k) == corners;
                polygon.clear();
                for _ in 0..n as usize {
                    let value = numbers.next(property.kind)?;
                    if is_polygon {
                        polygon.push(index(value)?);
                    }
                }
                if is_polygon {
                    fan(&polygon, &mut mesh.triangles)?;
                }
            }
            if let (true, [Some(x), Some(y), Some(z)]) = (is_vertex, xyz) {
                mesh.vertices
                    .push(Vec3::new(values[x], values[y], values[z]));
            }
        }
        Ok(())
    }
}

fn index(value: f64) -> Parsed<u32> {
    if value >= 0.0 && value < f64::from(u32::MAX) && value.fract() == 0.0 {
        Ok(value as u32)
    } else {
        Err(format!("a face names vertex {value}"))
    }
}

/// A polygon as triangles around its first corner.
pub(crate) fn fan(polygon: &[u32], triangles: &mut Vec<[u32; 3]>) -> Parsed<()> {
    for pair in polygon.windows(2).skip(1) {
        triangles.push([polygon[0], pair[0], pair[1]]);
    }
    if triangles.len() > MAX_TRIANGLES {
        return Err(format!("more than {MAX_TRIANGLES} triangles"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::tests::tetrahedron;

    fn text(mesh: &TriMesh) -> String {
        let mut s = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
             element face {}\nproperty list uchar int vertex_index\nend_header\n",
            mesh.vertices.len(),
            mesh.triangles.len()
        );
        for p in &mesh.vertices {
            s += &format!("{} {} {} 7\n", p.x, p.y, p.z);
        }
        for [a, b, c] in &mesh.triangles {
            s += &format!("3 {a} {b} {c}\n");
        }
        s
    }

    fn big_endian(mesh: &TriMesh) -> Vec<u8> {
        let mut s = format!(
            "ply\nformat binary_big_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {}\nproperty list uchar int vertex_indices\nend_header\n",
            mesh.vertices.len(),
            mesh.triangles.len()
        )
        .into_bytes();
        for p in &mesh.vertices {
            s.extend(p.iter().flat_map(|c| (*c as f32).to_be_bytes()));
        }
        for t in &mesh.triangles {
            s.push(3);
            s.extend(t.iter().flat_map(|v| v.to_be_bytes()));
        }
        s
    }

    #[test]
    fn all_codings_give_the_mesh_back() {
        let mesh = tetrahedron();
        for bytes in [
            text(&mesh).into_bytes(),
            big_endian(&mesh),
            to_binary_ply(&mesh),
        ] {
            assert_eq!(parse_ply(&bytes, "jaw.ply").unwrap(), mesh);
        }
    }

    #[test]
    fn the_writer_is_exact() {
        let mut mesh = tetrahedron();
        mesh.vertices.iter_mut().for_each(|p| *p *= 1.0 / 3.0);
        assert_eq!(parse_ply(&to_binary_ply(&mesh), "jaw").unwrap(), mesh);
    }

    #[test]
    fn polygons_become_fans() {
        let quad = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                    element face 1\nproperty list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n";
        let mesh = parse_ply(quad.as_bytes(), "quad").unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn faults_are_told_in_one_line() {
        let refusal = |bytes: &[u8]| parse_ply(bytes, "jaw.ply").unwrap_err().to_string();
        let whole = to_binary_ply(&tetrahedron());
        assert!(refusal(&whole[..whole.len() - 4]).contains("truncated"));
        assert!(refusal(b"\x89PNG\r\n").contains("does not begin with \"ply\""));
        let good = text(&tetrahedron());
        assert!(refusal(good.replace("3 1 2 3", "3 1 2 9").as_bytes()).contains("names vertex 9"));
        assert!(refusal(good.replace("10 0 0 7", "10 x 0 7").as_bytes()).contains("not a number"));
        assert!(
            refusal(good.replace("10 0 0 7", "nan 0 0 7").as_bytes())
                .contains("not a finite number")
        );
        let huge = good.replace("element vertex 4", "element vertex 4000000000");
        assert!(refusal(huge.as_bytes()).contains("at most"));
    }
}
