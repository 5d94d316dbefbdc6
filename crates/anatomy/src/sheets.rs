//! Open surfaces such as a crack: STL, PLY or OBJ, cut into connected sheets.
use crate::error::AnatomyError;
use crate::stl::{parse_stl, read_limited};
use crate::surface::weld;
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use rustc_hash::FxHashMap;
use std::path::Path;

const MAX_BYTES: u64 = 1 << 28;
/// Triangles that a surface may have.
pub const MAX_SHEET_TRIANGLES: usize = 200_000;

/// Reads a surface and cuts it into sheets whose triangles hang together by edges; equal corners are welded, neighbours that
/// look opposite ways turned to agree with the sheet's first triangle.
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, damaged, too large, of another kind, or not manifold.
pub fn read_sheets(path: &Path) -> Result<Vec<TriMesh>, AnatomyError> {
    let name = path.display().to_string();
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    let parse = match extension.to_ascii_lowercase().as_str() {
        "stl" => parse_stl,
        "ply" => parse_ply,
        "obj" => parse_obj,
        _ => {
            return Err(AnatomyError::Format {
                path: name,
                format: "surface",
                reason: format!("\".{extension}\" is not known; give .stl, .ply or .obj"),
            });
        }
    };
    let mesh = parse(&read_limited(path, MAX_BYTES)?, &name)?;
    if mesh.triangles.len() > MAX_SHEET_TRIANGLES {
        return Err(AnatomyError::TooLarge {
            what: format!("{name} (triangles)"),
            size: mesh.triangles.len() as u64,
            limit: MAX_SHEET_TRIANGLES as u64,
        });
    }
    sheets(&mesh, &name)
}

/// Cuts a welded surface into consistently oriented sheets; `name` is for error texts.
///
/// # Errors
/// [`AnatomyError::NonManifold`] where more than two triangles share an edge or sheets touch in a border vertex only,
/// [`AnatomyError::Orientation`] for a surface with one side only.
pub fn sheets(mesh: &TriMesh, name: &str) -> Result<Vec<TriMesh>, AnatomyError> {
    let mut around: FxHashMap<[u32; 2], Vec<usize>> = FxHashMap::default();
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for k in 0..3 {
            around.entry(key(triangle, k)).or_default().push(t);
        }
    }
    let mut crowded: Vec<_> = around.iter().filter(|e| e.1.len() > 2).collect();
    crowded.sort();
    if let Some((edge, _)) = crowded.first() {
        return Err(AnatomyError::NonManifold {
            name: name.to_owned(),
            n_edges: crowded.len(),
            near: mesh.vertices[edge[0] as usize],
        });
    }
    let mut triangles = mesh.triangles.clone();
    let mut sheet_of = vec![usize::MAX; triangles.len()];
    let mut found = Vec::new();
    for first in 0..triangles.len() {
        if sheet_of[first] != usize::MAX {
            continue;
        }
        sheet_of[first] = found.len();
        let mut members = vec![first];
        let mut next = 0;
        while let Some(&t) = members.get(next) {
            next += 1;
            for k in 0..3 {
                let edge = key(&triangles[t], k);
                for &other in around[&edge].iter().filter(|o| **o != t) {
                    let agrees = runs(&triangles[other], &edge) != runs(&triangles[t], &edge);
                    if sheet_of[other] == usize::MAX {
                        sheet_of[other] = found.len();
                        members.push(other);
                        if !agrees {
                            triangles[other].swap(1, 2);
                        }
                    } else if !agrees {
                        return Err(AnatomyError::Orientation {
                            name: name.to_owned(),
                            n_edges: 1,
                            near: mesh.vertices[edge[0] as usize],
                        });
                    }
                }
            }
        }
        members.sort_unstable();
        found.push(part(mesh, &triangles, &members));
    }
    for sheet in &found {
        check_border(sheet, name)?;
    }
    Ok(found)
}

fn key(triangle: &[u32; 3], k: usize) -> [u32; 2] {
    let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
    [a.min(b), a.max(b)]
}

/// Whether a triangle runs along an edge from its lower to its higher vertex.
fn runs(triangle: &[u32; 3], edge: &[u32; 2]) -> bool {
    (0..3).any(|k| [triangle[k], triangle[(k + 1) % 3]] == *edge)
}

fn part(mesh: &TriMesh, triangles: &[[u32; 3]], members: &[usize]) -> TriMesh {
    let mut number: FxHashMap<u32, u32> = FxHashMap::default();
    let mut out = TriMesh::default();
    for &t in members {
        let triangle = triangles[t].map(|v| {
            *number.entry(v).or_insert_with(|| {
                out.vertices.push(mesh.vertices[v as usize]);
                out.vertices.len() as u32 - 1
            })
        });
        out.triangles.push(triangle);
    }
    out
}

/// Each vertex of a border is passed once.
fn check_border(sheet: &TriMesh, name: &str) -> Result<(), AnatomyError> {
    let border = sheet.border_edges();
    match border.windows(2).find(|w| w[0][0] == w[1][0]) {
        None => Ok(()),
        Some(twice) => Err(AnatomyError::NonManifold {
            name: name.to_owned(),
            n_edges: 1,
            near: sheet.vertices[twice[0][0] as usize],
        }),
    }
}

/// Welds polygons, fans them into triangles and refuses what is not finite.
fn from_polygons(
    format: &'static str,
    name: &str,
    points: &[Vec3],
    polygons: &[Vec<usize>],
) -> Result<TriMesh, AnatomyError> {
    let bad = |reason: String| AnatomyError::Format {
        path: name.to_owned(),
        format,
        reason,
    };
    if let Some(vertex) = points.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
        return Err(AnatomyError::NotFinite {
            name: name.to_owned(),
            vertex,
        });
    }
    let mut corners = Vec::new();
    for (f, polygon) in polygons.iter().enumerate() {
        if let Some(v) = polygon.iter().find(|v| **v >= points.len()) {
            let n = points.len();
            return Err(bad(format!(
                "face {f} names vertex {v}, but there are only {n} vertices"
            )));
        }
        if polygon.len() < 3 {
            return Err(bad(format!("face {f} has {} corners", polygon.len())));
        }
        for k in 1..polygon.len() - 1 {
            corners.push([polygon[0], polygon[k], polygon[k + 1]].map(|v| points[v]));
        }
    }
    let mesh = weld(&corners);
    if mesh.triangles.is_empty() {
        let name = name.to_owned();
        return Err(AnatomyError::EmptySurface { name });
    }
    Ok(mesh)
}

/// Parses Wavefront OBJ from memory: `v` and `f` lines, anything else is passed over.
///
/// # Errors
/// [`AnatomyError`] for a file that is damaged or holds no triangles.
pub fn parse_obj(bytes: &[u8], name: &str) -> Result<TriMesh, AnatomyError> {
    let text = String::from_utf8_lossy(bytes);
    let (mut points, mut polygons) = (Vec::new(), Vec::new());
    for (i, line) in text.lines().enumerate() {
        let bad = |what: &str| AnatomyError::Format {
            path: name.to_owned(),
            format: "OBJ",
            reason: format!("line {}: {what}", i + 1),
        };
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let numbers: Vec<f64> = words.map_while(|w| w.parse().ok()).collect();
                let [x, y, z, ..] = numbers[..] else {
                    return Err(bad("`v` needs three numbers"));
                };
                points.push(Vec3::new(x, y, z));
            }
            Some("f") => {
                // Counted from 1; negative numbers count back from the last vertex so far.
                let vertex = |w: &str| {
                    let number: i64 = w.split('/').next()?.parse().ok()?;
                    let place = if number < 0 {
                        points.len() as i64 + number
                    } else {
                        number - 1
                    };
                    usize::try_from(place).ok()
                };
                let polygon: Option<Vec<usize>> = words.map(vertex).collect();
                polygons.push(polygon.ok_or_else(|| bad("`f` needs vertex numbers from 1"))?);
            }
            _ => {}
        }
    }
    from_polygons("OBJ", name, &points, &polygons)
}

/// Parses PLY (text or binary) from memory: vertices with x, y, z and faces by `vertex_indices`.
///
/// # Errors
/// [`AnatomyError`] for a file that is damaged or holds no triangles.
pub fn parse_ply(bytes: &[u8], name: &str) -> Result<TriMesh, AnatomyError> {
    let (points, polygons) = Ply::read(bytes).map_err(|reason| AnatomyError::Format {
        path: name.to_owned(),
        format: "PLY",
        reason,
    })?;
    from_polygons("PLY", name, &points, &polygons)
}

type Parsed<T> = Result<T, String>;

struct PlyProperty {
    name: String,
    /// Type of a list's length.
    list: Option<String>,
    kind: String,
}

struct PlyElement {
    name: String,
    count: usize,
    properties: Vec<PlyProperty>,
}

#[derive(Clone, Copy, PartialEq)]
enum PlyForm {
    Ascii,
    Little,
    Big,
}

struct Ply<'a> {
    rest: &'a [u8],
    form: PlyForm,
}

impl Ply<'_> {
    fn read(bytes: &[u8]) -> Parsed<(Vec<Vec3>, Vec<Vec<usize>>)> {
        let (form, elements, rest) = ply_header(bytes)?;
        let mut ply = Ply { rest, form };
        let (mut points, mut polygons) = (Vec::new(), Vec::new());
        for element in &elements {
            for _ in 0..element.count {
                let mut point = Vec3::repeat(f64::NAN);
                for p in &element.properties {
                    let n = match &p.list {
                        Some(kind) => ply.number(kind)? as usize,
                        None => 1,
                    };
                    let is_face = element.name == "face"
                        && p.list.is_some()
                        && p.name.starts_with("vertex_ind");
                    let mut polygon = Vec::new();
                    for _ in 0..n {
                        let v = ply.number(&p.kind)?;
                        if is_face {
                            polygon.push(v as usize);
                        }
                        if let Some(axis) = ["x", "y", "z"].iter().position(|a| *a == p.name) {
                            point[axis] = v;
                        }
                    }
                    if is_face {
                        polygons.push(polygon);
                    }
                }
                if element.name == "vertex" {
                    points.push(point);
                }
            }
        }
        Ok((points, polygons))
    }

    fn number(&mut self, kind: &str) -> Parsed<f64> {
        let truncated = || "the file ends within its data; it is truncated".to_owned();
        if self.form == PlyForm::Ascii {
            let begin = self.rest.iter().position(|b| !b.is_ascii_whitespace());
            let rest = &self.rest[begin.ok_or_else(truncated)?..];
            let n = rest.iter().position(u8::is_ascii_whitespace);
            let (word, rest) = rest.split_at(n.unwrap_or(rest.len()));
            self.rest = rest;
            let word = String::from_utf8_lossy(&word[..word.len().min(40)]);
            return word
                .parse()
                .map_err(|_| format!("\"{word}\" is not a number"));
        }
        let width = match kind {
            "char" | "uchar" | "int8" | "uint8" => 1,
            "short" | "ushort" | "int16" | "uint16" => 2,
            "int" | "uint" | "float" | "int32" | "uint32" | "float32" => 4,
            "double" | "float64" => 8,
            other => return Err(format!("numbers of type \"{other}\" are not known")),
        };
        let (own, rest) = self.rest.split_at_checked(width).ok_or_else(truncated)?;
        self.rest = rest;
        let mut b = [0; 8];
        b[..width].copy_from_slice(own);
        if self.form == PlyForm::Big {
            b[..width].reverse();
        }
        let [b0, b1, b2, b3, ..] = b;
        Ok(match kind {
            "char" | "int8" => f64::from(b0 as i8),
            "uchar" | "uint8" => f64::from(b0),
            "short" | "int16" => f64::from(i16::from_le_bytes([b0, b1])),
            "ushort" | "uint16" => f64::from(u16::from_le_bytes([b0, b1])),
            "int" | "int32" => f64::from(i32::from_le_bytes([b0, b1, b2, b3])),
            "uint" | "uint32" => f64::from(u32::from_le_bytes([b0, b1, b2, b3])),
            "float" | "float32" => f64::from(f32::from_le_bytes([b0, b1, b2, b3])),
            _ => f64::from_le_bytes(b),
        })
    }
}

fn ply_header(bytes: &[u8]) -> Parsed<(PlyForm, Vec<PlyElement>, &[u8])> {
    const END: &[u8] = b"end_header";
    let head = &bytes[..bytes.len().min(1 << 16)];
    let end = head.windows(END.len()).position(|w| w == END);
    let end = end.ok_or("it has no end_header")?;
    let line_end = bytes[end..].iter().position(|b| *b == b'\n');
    let data = &bytes[end + line_end.ok_or("it ends with its header; it is truncated")? + 1..];
    let text = String::from_utf8_lossy(&head[..end]).into_owned();
    if !text.starts_with("ply") {
        return Err("it does not begin with ply".to_owned());
    }
    let mut form = None;
    let mut elements: Vec<PlyElement> = Vec::new();
    for line in text.lines() {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words[..] {
            ["format", "ascii", _] => form = Some(PlyForm::Ascii),
            ["format", "binary_little_endian", _] => form = Some(PlyForm::Little),
            ["format", "binary_big_endian", _] => form = Some(PlyForm::Big),
            ["element", name, count] => {
                let n: usize = count
                    .parse()
                    .map_err(|_| format!("\"{count}\" is not a count"))?;
                // Each item has at least a byte, so no more can be there.
                if n > bytes.len() {
                    return Err(format!(
                        "{n} of {name} are announced in a file of {} bytes; it is truncated",
                        bytes.len()
                    ));
                }
                elements.push(PlyElement {
                    name: name.to_owned(),
                    count: n,
                    properties: Vec::new(),
                });
            }
            ["property", "list", length, kind, name] => {
                let property = PlyProperty {
                    name: name.to_owned(),
                    list: Some(length.to_owned()),
                    kind: kind.to_owned(),
                };
                let last = elements.last_mut().ok_or("a property before any element")?;
                last.properties.push(property);
            }
            ["property", kind, name] => {
                let property = PlyProperty {
                    name: name.to_owned(),
                    list: None,
                    kind: kind.to_owned(),
                };
                let last = elements.last_mut().ok_or("a property before any element")?;
                last.properties.push(property);
            }
            _ => {}
        }
    }
    Ok((form.ok_or("it has no format line")?, elements, data))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two squares, the second apart and with one triangle turned over.
    const OBJ: &str = "# crack\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 5 0 0\nv 6 0 0\nv 6 1 0\nv 5 1 0\nf 1 2 3 4\nf 5/1 6/2 7/3\nf -4 -1 -2\n";

    #[test]
    fn sheets_are_told_apart_and_oriented() {
        let mesh = parse_obj(OBJ.as_bytes(), "c.obj").unwrap();
        let parts = sheets(&mesh, "c.obj").unwrap();
        assert_eq!(parts.len(), 2);
        for p in &parts {
            assert_eq!((p.vertices.len(), p.triangles.len()), (4, 2));
            assert!((0..2).all(|t| p.area_normal(t).z == 1.0));
            assert_eq!(p.border_edges().len(), 4);
        }
    }

    #[test]
    fn all_plys_hold_the_same_square() {
        let head = |form: &str| {
            format!(
                "ply\nformat {form} 1.0\ncomment c\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
            )
        };
        let square = [
            [0.0f32, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 0.0],
        ];
        let text = head("ascii") + "0 0 0 9\n1 0 0 9\n1 1 0 9\n0 1 0 9\n4 0 1 2 3\n";
        let binary = |form: &str, big: bool| {
            let mut b = head(form).into_bytes();
            for p in square {
                for c in p {
                    b.extend(if big {
                        c.to_be_bytes()
                    } else {
                        c.to_le_bytes()
                    });
                }
                b.push(9);
            }
            b.push(4);
            for i in 0..4i32 {
                b.extend(if big {
                    i.to_be_bytes()
                } else {
                    i.to_le_bytes()
                });
            }
            b
        };
        for bytes in [
            text.into_bytes(),
            binary("binary_little_endian", false),
            binary("binary_big_endian", true),
        ] {
            let mesh = parse_ply(&bytes, "c.ply").unwrap();
            assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (4, 2));
            assert_eq!(mesh.area(), 1.0);
            for n in 0..bytes.len() - 1 {
                assert!(parse_ply(&bytes[..n], "c.ply").is_err(), "{n} bytes");
            }
        }
    }

    #[test]
    fn faults_are_told_in_one_line() {
        let refused = |text: String, part: &str| {
            let parsed = parse_obj(text.as_bytes(), "c.obj");
            let error = parsed
                .and_then(|m| sheets(&m, "c.obj"))
                .unwrap_err()
                .to_string();
            assert!(error.contains(part) && !error.contains('\n'), "{error}");
        };
        refused(OBJ.replace("v 1 1 0", "v 1 nan 0"), "not a finite number");
        refused(OBJ.replace("f 1 2 3 4", "f 1 2 99"), "names vertex 98");
        refused(
            OBJ.replace("v 1 1 0", "v 1 1"),
            "line 4: `v` needs three numbers",
        );
        refused("v 0 0 0\n".to_owned(), "no triangles");
        let fin = "v 0.5 0.5 3\nf 1 3 9\n";
        refused(OBJ.to_owned() + fin, "not manifold");
        let ply =
            b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n";
        assert!(
            parse_ply(ply, "c.ply")
                .unwrap_err()
                .to_string()
                .contains("announced")
        );
    }
}
