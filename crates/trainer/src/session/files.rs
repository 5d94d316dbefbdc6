//! `crack.ply` and `bone_final.vtu`.
use std::fmt::Write;

/// The crack surface with its kerf.
pub struct CrackMesh<'a> {
    /// \[mm\]
    pub vertices: &'a [[f64; 3]],
    /// Indices into them.
    pub triangles: &'a [[u32; 3]],
    /// Half width at each vertex \[mm\].
    pub kerf: &'a [f64],
}

/// The crack as PLY (ASCII): `kerf` is a vertex property.
pub fn write_crack(crack: &CrackMesh) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\ncomment osteotome.crack/1, mm; kerf = half width of the saw's slit, 0 where the bone broke\n\
         element vertex {}\nproperty double x\nproperty double y\nproperty double z\nproperty double kerf\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        crack.vertices.len(),
        crack.triangles.len()
    );
    for ([x, y, z], kerf) in crack.vertices.iter().zip(crack.kerf) {
        let _ = writeln!(text, "{x} {y} {z} {kerf}"); // a String takes everything
    }
    for [a, b, c] in crack.triangles {
        let _ = writeln!(text, "3 {a} {b} {c}");
    }
    text
}

/// The bone at the end: one tetrahedron a cell, so that a cut element appears once for each of its pieces.
pub struct FinalBone {
    /// Undeformed corners; cells share them where they move alike \[mm\].
    pub points: Vec<[f64; 3]>,
    /// Displacement of each \[mm\].
    pub displacement: Vec<[f64; 3]>,
    /// Corners of each cell.
    pub cells: Vec<[u32; 4]>,
    /// The piece each cell belongs to.
    pub fragment: Vec<u32>,
    /// Share of the element that is this cell's.
    pub volume_fraction: Vec<f64>,
}

/// The bone as VTU (XML, ASCII).
pub fn write_final_bone(bone: &FinalBone) -> String {
    let mut text = format!(
        "<?xml version=\"1.0\"?>\n<!-- osteotome.bone_final/1, mm; a cut element appears once for each piece -->\n\
         <VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\">\n<UnstructuredGrid>\n\
         <Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n",
        bone.points.len(),
        bone.cells.len()
    );
    let triples = |list: &[[f64; 3]]| rows(list, |[x, y, z]| format!("{x} {y} {z}"));
    text += "<Points>\n";
    text += &array("Points", "Float64", 3, &triples(&bone.points));
    text += "</Points>\n<Cells>\n";
    let corners = rows(&bone.cells, |[a, b, c, d]| format!("{a} {b} {c} {d}"));
    text += &array("connectivity", "Int64", 1, &corners);
    let ends: Vec<_> = (1..=bone.cells.len()).map(|i| 4 * i).collect();
    text += &array("offsets", "Int64", 1, &rows(&ends, ToString::to_string));
    text += &array("types", "UInt8", 1, &rows(&ends, |_| "10".to_owned()));
    text += "</Cells>\n<PointData>\n";
    text += &array("displacement", "Float64", 3, &triples(&bone.displacement));
    text += "</PointData>\n<CellData>\n";
    text += &array(
        "fragment",
        "Int64",
        1,
        &rows(&bone.fragment, ToString::to_string),
    );
    let shares = rows(&bone.volume_fraction, ToString::to_string);
    text += &array("volume_fraction", "Float64", 1, &shares);
    text += "</CellData>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n";
    text
}

fn rows<T>(list: &[T], row: impl Fn(&T) -> String) -> String {
    list.iter().map(|item| row(item) + "\n").collect()
}

fn array(name: &str, kind: &str, components: u32, values: &str) -> String {
    format!(
        "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"ascii\">\n{values}</DataArray>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_agree_with_the_rows() {
        let crack = CrackMesh {
            vertices: &[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.5, 0.0]],
            triangles: &[[0, 1, 2]],
            kerf: &[0.4, 0.4, 0.0],
        };
        let text = write_crack(&crack);
        assert!(text.contains("element vertex 3\n") && text.contains("element face 1\n"));
        assert!(text.ends_with("0 1.5 0 0\n3 0 1 2\n"));
        let bone = FinalBone {
            points: vec![[0.0; 3]; 4],
            displacement: vec![[0.0, 0.0, 0.25]; 4],
            cells: vec![[0, 1, 2, 3]],
            fragment: vec![1],
            volume_fraction: vec![1.0],
        };
        let text = write_final_bone(&bone);
        assert!(text.contains("NumberOfPoints=\"4\" NumberOfCells=\"1\""));
        assert_eq!(text.matches("0 0 0.25\n").count(), 4);
        assert_eq!(
            text.matches("<DataArray").count(),
            text.matches("</DataArray>").count()
        );
    }
}
