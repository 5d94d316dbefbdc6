//! Wavefront OBJ: vertices and polygons; everything else in the file is passed over.
use crate::error::AnatomyError;
use crate::ply::fan;
use crate::stl::read_limited;
use crate::surface::{MAX_TRIANGLES, checked_surface};
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use std::path::Path;

const MAX_BYTES: u64 = 4 << 30;

/// Reads a surface \[mm\]; polygons become fans of triangles, vertices stay as they are shared in the file.
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, too large, or not of this form.
pub fn read_obj(path: &Path) -> Result<TriMesh, AnatomyError> {
    parse_obj(&read_limited(path, MAX_BYTES)?, &path.display().to_string())
}

/// Parses OBJ from memory; `name` is for error texts.
///
/// # Errors
/// As [`read_obj`].
pub fn parse_obj(bytes: &[u8], name: &str) -> Result<TriMesh, AnatomyError> {
    let mut mesh = TriMesh::default();
    let mut polygon = Vec::new();
    for (i, line) in bytes.split(|b| *b == b'\n').enumerate() {
        let line = String::from_utf8_lossy(line);
        read_line(&line, &mut mesh, &mut polygon).map_err(|reason| AnatomyError::Format {
            path: name.to_owned(),
            format: "OBJ",
            reason: format!("line {}: {reason}", i + 1),
        })?;
    }
    checked_surface(mesh, name, "OBJ")
}

fn read_line(line: &str, mesh: &mut TriMesh, polygon: &mut Vec<u32>) -> Result<(), String> {
    let mut words = line.split_ascii_whitespace();
    match words.next() {
        Some("v") => {
            // What follows the three coordinates is a weight or a colour.
            let numbers: Vec<f64> = words.take(3).map_while(|w| w.parse().ok()).collect();
            let [x, y, z] = numbers[..] else {
                return Err("`v` needs three numbers".to_owned());
            };
            if mesh.vertices.len() >= MAX_TRIANGLES {
                return Err(format!("more than {MAX_TRIANGLES} vertices"));
            }
            mesh.vertices.push(Vec3::new(x, y, z));
        }
        Some("f") => {
            polygon.clear();
            for word in words {
                polygon.push(corner(word, mesh.vertices.len())?);
            }
            if polygon.len() < 3 {
                return Err("`f` needs three corners or more".to_owned());
            }
            fan(polygon, &mut mesh.triangles)?;
        }
        _ => {}
    }
    Ok(())
}

/// `7`, `7/1`, `7//3` or `-1`, counted back from the last vertex.
fn corner(word: &str, n: usize) -> Result<u32, String> {
    let number: Option<i64> = word.split('/').next().and_then(|w| w.parse().ok());
    let index = match number {
        Some(k) if k > 0 => k - 1,
        Some(k) if k < 0 => (n as i64).saturating_add(k),
        _ => -1,
    };
    u32::try_from(index).map_err(|_| format!("\"{word}\" is no vertex, counted from 1"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::tests::tetrahedron;

    fn text(mesh: &TriMesh, is_relative: bool) -> String {
        let n = mesh.vertices.len() as i64;
        let mut s = "# jaw\no jaw\n".to_owned();
        for p in &mesh.vertices {
            s += &format!("v {} {} {}\n", p.x, p.y, p.z);
        }
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|v| i64::from(v) + if is_relative { -n } else { 1 });
            s += &format!("f {a} {b}/1 {c}//2\n");
        }
        s
    }

    #[test]
    fn vertices_may_be_counted_from_either_end() {
        let mesh = tetrahedron();
        for is_relative in [false, true] {
            let read = parse_obj(text(&mesh, is_relative).as_bytes(), "jaw.obj").unwrap();
            assert_eq!(read, mesh);
        }
    }

    #[test]
    fn faults_are_told_in_one_line() {
        let refusal = |text: &str| {
            parse_obj(text.as_bytes(), "jaw.obj")
                .unwrap_err()
                .to_string()
        };
        let good = text(&tetrahedron(), false);
        assert!(refusal(&good.replace("f 2", "f 0")).contains("line 7: \"0\" is no vertex"));
        assert!(refusal(&good.replace("f 2", "f 99")).contains("names vertex 98"));
        assert!(refusal(&good.replace("v 10 0 0", "v 10 0")).contains("line 4: `v` needs three"));
        assert!(refusal(&good.replace("v 10 0 0", "v inf 0 0")).contains("not a finite number"));
        assert!(refusal("hello").contains("no triangles"));
    }
}
