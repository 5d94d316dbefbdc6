//! STL, ASCII and binary.
use crate::error::AnatomyError;
use crate::surface::{MAX_TRIANGLES, weld};
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use std::io::Read;
use std::path::Path;

const HEADER: usize = 84;
const RECORD: usize = 50;

/// Reads a surface from an STL file \[mm\], equal corners welded.
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, truncated, too large, or holds numbers that are not finite.
pub fn read_stl(path: &Path) -> Result<TriMesh, AnatomyError> {
    let bytes = read_limited(path, (HEADER + RECORD * MAX_TRIANGLES) as u64)?;
    parse_stl(&bytes, &path.display().to_string())
}

/// Parses STL from memory; `name` is for error texts.
///
/// # Errors
/// As [`read_stl`].
pub fn parse_stl(bytes: &[u8], name: &str) -> Result<TriMesh, AnatomyError> {
    let corners = match announced(bytes) {
        Some(n) if bytes.len() == HEADER + RECORD * n => binary(bytes),
        _ if looks_like_text(bytes) => ascii(bytes, name)?,
        Some(n) if bytes.len() > HEADER + RECORD * n && n > 0 => {
            binary(&bytes[..HEADER + RECORD * n])
        }
        Some(n) => {
            let have = bytes.len().saturating_sub(HEADER) / RECORD;
            let reason = format!(
                "the header announces {n} triangles, but only {have} are there; the file is truncated"
            );
            return Err(bad(name, reason));
        }
        None => {
            let reason = format!("{} bytes are too few for any triangle", bytes.len());
            return Err(bad(name, reason));
        }
    };
    let finite = |c: &[Vec3; 3]| c.iter().all(|p| p.iter().all(|x| x.is_finite()));
    if let Some(t) = corners.iter().position(|c| !finite(c)) {
        let reason = format!("triangle {t} has a coordinate that is not a finite number");
        return Err(bad(name, reason));
    }
    let mesh = weld(&corners);
    if mesh.triangles.is_empty() {
        let name = name.to_owned();
        return Err(AnatomyError::EmptySurface { name });
    }
    Ok(mesh)
}

/// Reads a whole file that must not be larger than `limit` bytes.
pub(crate) fn read_limited(path: &Path, limit: u64) -> Result<Vec<u8>, AnatomyError> {
    let mut bytes = Vec::new();
    crate::input::open_limited(path, limit)?
        .take(limit)
        .read_to_end(&mut bytes)
        .map_err(|e| AnatomyError::Read {
            path: path.display().to_string(),
            reason: e.to_string(),
        })?;
    Ok(bytes)
}

fn bad(name: &str, reason: String) -> AnatomyError {
    AnatomyError::Format {
        path: name.to_owned(),
        format: "STL",
        reason,
    }
}

fn announced(bytes: &[u8]) -> Option<usize> {
    let n = bytes.get(80..HEADER)?;
    Some(u32::from_le_bytes(n.try_into().ok()?) as usize)
}

fn looks_like_text(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().starts_with(b"solid") && !bytes.contains(&0)
}

fn binary(bytes: &[u8]) -> Vec<[Vec3; 3]> {
    let float = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let point = |b: &[u8]| Vec3::new(float(b), float(&b[4..]), float(&b[8..]));
    bytes[HEADER..]
        .chunks_exact(RECORD)
        .map(|r| [point(&r[12..]), point(&r[24..]), point(&r[36..])])
        .collect()
}

fn ascii(bytes: &[u8], name: &str) -> Result<Vec<[Vec3; 3]>, AnatomyError> {
    let text = String::from_utf8_lossy(bytes);
    let mut corners = Vec::new();
    let mut triangle = Vec::with_capacity(3);
    let mut ended = false;
    for (i, line) in text.lines().enumerate() {
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("vertex") => {
                let numbers: Vec<f64> = words.map_while(|w| w.parse().ok()).collect();
                let [x, y, z] = numbers[..] else {
                    let reason = format!("line {}: `vertex` needs three numbers", i + 1);
                    return Err(bad(name, reason));
                };
                triangle.push(Vec3::new(x, y, z));
            }
            Some("endfacet" | "endloop") if !triangle.is_empty() => {
                let Ok(t) = <[Vec3; 3]>::try_from(std::mem::take(&mut triangle)) else {
                    let reason = format!("line {}: a facet must have three vertices", i + 1);
                    return Err(bad(name, reason));
                };
                corners.push(t);
            }
            Some("endsolid") => ended = true,
            _ => {}
        }
    }
    if !ended || !triangle.is_empty() {
        let reason = format!(
            "it ends after {} triangles without `endsolid`; the file is truncated",
            corners.len()
        );
        return Err(bad(name, reason));
    }
    Ok(corners)
}

/// A surface as binary STL.
pub fn to_binary_stl(mesh: &TriMesh) -> Vec<u8> {
    let mut out = vec![0u8; 80];
    out.extend((mesh.triangles.len() as u32).to_le_bytes());
    for t in 0..mesh.triangles.len() {
        let normal = mesh.area_normal(t);
        let normal = normal / normal.norm().max(f64::MIN_POSITIVE);
        for p in std::iter::once(normal).chain(mesh.corners(t)) {
            out.extend(p.iter().flat_map(|c| (*c as f32).to_le_bytes()));
        }
        out.extend([0, 0]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::tests::tetrahedron;
    use std::fmt::Write;

    fn to_text(mesh: &TriMesh) -> String {
        let mut s = String::from("solid jaw\n");
        for t in 0..mesh.triangles.len() {
            s += "facet normal 0 0 0\n outer loop\n";
            for p in mesh.corners(t) {
                writeln!(s, "  vertex {} {} {}", p.x, p.y, p.z).unwrap();
            }
            s += " endloop\nendfacet\n";
        }
        s + "endsolid jaw\n"
    }

    fn by_position(mesh: &TriMesh) -> Vec<[Vec3; 3]> {
        (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect()
    }

    #[test]
    fn both_forms_give_the_welded_mesh_back() {
        let mesh = tetrahedron();
        for bytes in [to_binary_stl(&mesh), to_text(&mesh).into_bytes()] {
            let read = parse_stl(&bytes, "jaw.stl").unwrap();
            assert_eq!(read.vertices.len(), 4);
            assert_eq!(by_position(&read), by_position(&mesh));
        }
    }

    #[test]
    fn faults_are_told_in_one_line() {
        let refusal = |bytes: &[u8]| parse_stl(bytes, "jaw.stl").unwrap_err().to_string();
        let whole = to_binary_stl(&tetrahedron());
        assert_eq!(
            refusal(&whole[..200]),
            "jaw.stl is not a usable STL file: the header announces 4 triangles, but only 2 are there; the file is truncated"
        );
        assert!(refusal(&whole[..40]).contains("40 bytes are too few"));
        let mut nan = whole.clone();
        nan[96..100].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(refusal(&nan).contains("triangle 0 has a coordinate that is not a finite number"));
        let text = to_text(&tetrahedron());
        assert!(refusal(&text.as_bytes()[..text.len() / 2]).contains("truncated"));
        let broken = text.replace("vertex 10 0 0", "vertex 10 zero 0");
        assert!(refusal(broken.as_bytes()).contains("`vertex` needs three numbers"));
        assert!(refusal(b"solid\nendsolid\n").contains("no triangles"));
        let missing = read_stl(Path::new("no-such-jaw.stl"))
            .unwrap_err()
            .to_string();
        assert!(
            missing.starts_with("cannot read no-such-jaw.stl: "),
            "{missing}"
        );
        assert!(!missing.contains('\n'));
    }
}
