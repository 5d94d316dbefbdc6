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
    /// Level sets phi1, phi2, phi3 of the crack at each; phi2 is -1 without a front \[mm\].
    pub level_sets: [Vec<f64>; 3],
    /// Corners of each cell.
    pub cells: Vec<[u32; 4]>,
    /// The piece each cell belongs to.
    pub fragment: Vec<u32>,
    /// Share of the element that is this cell's.
    pub volume_fraction: Vec<f64>,
}

/// The bone as VTU (XML, ASCII).
pub fn write_final_bone(bone: &FinalBone) -> String {
    VtuWriter::new("osteotome.bone_final/1, mm; a cut element appears once for each piece")
        .points(&bone.points)
        .tetrahedra(&bone.cells)
        .point_vectors("displacement", &bone.displacement)
        .point_numbers("phi1", &bone.level_sets[0])
        .point_numbers("phi2", &bone.level_sets[1])
        .point_numbers("phi3", &bone.level_sets[2])
        .cell_indices("fragment", &bone.fragment)
        .cell_numbers("volume_fraction", &bone.volume_fraction)
        .finish()
}

/// An unstructured grid of tetrahedra in the making (VTU: XML, ASCII).
#[derive(Debug, Default)]
pub struct VtuWriter {
    comment: String,
    n_points: usize,
    n_cells: usize,
    geometry: String,
    point_data: String,
    cell_data: String,
}

impl VtuWriter {
    /// `comment`: schema and units; must not hold two hyphens in a row.
    pub fn new(comment: &str) -> Self {
        Self {
            comment: comment.to_owned(),
            ..Self::default()
        }
    }

    /// Positions.
    pub fn points(mut self, points: &[[f64; 3]]) -> Self {
        self.n_points = points.len();
        self.geometry += &format!("<Points>\n{}</Points>\n", vectors("Points", points));
        self
    }

    /// Corners of each cell.
    pub fn tetrahedra(mut self, cells: &[[u32; 4]]) -> Self {
        self.n_cells = cells.len();
        let corners = rows(cells, |[a, b, c, d]| format!("{a} {b} {c} {d}"));
        let ends: Vec<_> = (1..=cells.len()).map(|i| 4 * i).collect();
        self.geometry += "<Cells>\n";
        self.geometry += &array("connectivity", "Int64", 1, &corners);
        self.geometry += &array("offsets", "Int64", 1, &rows(&ends, ToString::to_string));
        self.geometry += &array("types", "UInt8", 1, &rows(&ends, |_| "10".to_owned()));
        self.geometry += "</Cells>\n";
        self
    }

    /// A vector at each point.
    pub fn point_vectors(mut self, name: &str, values: &[[f64; 3]]) -> Self {
        self.point_data += &vectors(name, values);
        self
    }

    /// A number at each point.
    pub fn point_numbers(mut self, name: &str, values: &[f64]) -> Self {
        self.point_data += &array(name, "Float64", 1, &rows(values, |v| number(*v)));
        self
    }

    /// A number in each cell.
    pub fn cell_numbers(mut self, name: &str, values: &[f64]) -> Self {
        self.cell_data += &array(name, "Float64", 1, &rows(values, |v| number(*v)));
        self
    }

    /// A whole number in each cell.
    pub fn cell_indices(mut self, name: &str, values: &[u32]) -> Self {
        self.cell_data += &array(name, "Int64", 1, &rows(values, ToString::to_string));
        self
    }

    /// The file.
    pub fn finish(self) -> String {
        format!(
            "<?xml version=\"1.0\"?>\n<!-- {} -->\n\
             <VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\">\n<UnstructuredGrid>\n\
             <Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n{}\
             <PointData>\n{}</PointData>\n<CellData>\n{}</CellData>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n",
            self.comment,
            self.n_points,
            self.n_cells,
            self.geometry,
            self.point_data,
            self.cell_data
        )
    }
}

/// Shortest text that reads back the same, with an exponent where it is far from 1.
fn number(v: f64) -> String {
    if v.fract() == 0.0 && v.abs() < 1e15 {
        format!("{v}")
    } else {
        format!("{v:?}")
    }
}

fn vectors(name: &str, values: &[[f64; 3]]) -> String {
    let row = |v: &[f64; 3]| v.map(number).join(" ");
    array(name, "Float64", 3, &rows(values, row))
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
            level_sets: [vec![0.5; 4], vec![1.25; 4], vec![-0.75; 4]],
            cells: vec![[0, 1, 2, 3]],
            fragment: vec![1],
            volume_fraction: vec![1.0],
        };
        let text = write_final_bone(&bone);
        assert!(text.contains("NumberOfPoints=\"4\" NumberOfCells=\"1\""));
        assert_eq!(text.matches("0 0 0.25\n").count(), 4);
        assert!(text.contains("Name=\"phi2\"") && text.contains("1.25"));
        assert_eq!(
            text.matches("<DataArray").count(),
            text.matches("</DataArray>").count()
        );
    }
}
