//! Gmsh .msh, 2.2 and 4.1, ASCII and binary: linear tetrahedra with their physical groups.
use crate::error::AnatomyError;
use crate::stl::read_limited;
use osteotome_mechanics::geometry::{TetMesh, Vec3};
use rustc_hash::FxHashMap;
use std::path::Path;

/// A physical group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PhysicalGroup {
    /// Gmsh's number.
    pub id: i32,
    /// Its name; empty if the file gives none.
    pub name: String,
}

/// What a .msh file holds.
#[derive(Clone, Debug)]
pub struct MeshFile {
    /// The tetrahedra; nodes that none of them uses are left out.
    pub mesh: TetMesh,
    /// Physical volumes.
    pub volumes: Vec<PhysicalGroup>,
    /// For each tetrahedron its index into `volumes`, or `None`.
    pub tet_volume: Vec<Option<u32>>,
    /// Physical surfaces with their triangles.
    pub surfaces: Vec<(PhysicalGroup, Vec<[u32; 3]>)>,
}

const MAX_BYTES: u64 = 4 << 30;
const MAX_ITEMS: u64 = 50_000_000;

/// Reads a Gmsh file.
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, truncated, of another version, or whose tetrahedra are not usable.
pub fn read_msh(path: &Path) -> Result<MeshFile, AnatomyError> {
    let bytes = read_limited(path, MAX_BYTES)?;
    parse_msh(&bytes, &path.display().to_string())
}

/// Parses a Gmsh file from memory; `name` is for error texts.
///
/// # Errors
/// As [`read_msh`].
pub fn parse_msh(bytes: &[u8], name: &str) -> Result<MeshFile, AnatomyError> {
    let mut reader = Reader {
        bytes,
        pos: 0,
        binary: false,
        section: String::new(),
    };
    let raw = reader.file().map_err(|reason| AnatomyError::Format {
        path: name.to_owned(),
        format: "Gmsh .msh",
        reason: format!("in section {}: {reason}", reader.section),
    })?;
    raw.into_mesh(name)
}

#[derive(Default)]
struct Raw {
    names: FxHashMap<(i32, i32), String>,
    /// Physical group of each surface and volume entity (4.1).
    entities: FxHashMap<(i32, i32), i32>,
    index: FxHashMap<u64, u32>,
    nodes: Vec<Vec3>,
    /// Node numbers and physical group (0: none).
    tets: Vec<([u64; 4], i32)>,
    triangles: Vec<([u64; 3], i32)>,
}

impl Raw {
    fn into_mesh(self, name: &str) -> Result<MeshFile, AnatomyError> {
        let bad = |reason: String| AnatomyError::Format {
            path: name.to_owned(),
            format: "Gmsh .msh",
            reason,
        };
        if self.tets.is_empty() {
            return Err(bad(
                "it holds no linear tetrahedra; save the volume mesh with order 1".to_owned(),
            ));
        }
        let mut used = vec![u32::MAX; self.nodes.len()];
        let mut nodes = Vec::new();
        let mut tets = Vec::with_capacity(self.tets.len());
        for (t, (tet, _)) in self.tets.iter().enumerate() {
            let mut out = [0; 4];
            for k in 0..4 {
                let Some(&i) = self.index.get(&tet[k]) else {
                    return Err(bad(format!(
                        "tetrahedron {t} names node {}, which is not there",
                        tet[k]
                    )));
                };
                let slot = &mut used[i as usize];
                if *slot == u32::MAX {
                    *slot = nodes.len() as u32;
                    nodes.push(self.nodes[i as usize]);
                }
                out[k] = *slot;
            }
            tets.push(out);
        }
        let mut volumes: Vec<i32> = self.tets.iter().map(|t| t.1).filter(|g| *g != 0).collect();
        volumes.sort_unstable();
        volumes.dedup();
        let tet_volume = self
            .tets
            .iter()
            .map(|t| volumes.binary_search(&t.1).ok().map(|i| i as u32))
            .collect();
        let group = |dimension: i32, id: i32| PhysicalGroup {
            id,
            name: self
                .names
                .get(&(dimension, id))
                .cloned()
                .unwrap_or_default(),
        };
        let mut by_surface: FxHashMap<i32, Vec<[u32; 3]>> = FxHashMap::default();
        for (triangle, id) in self.triangles.iter().filter(|t| t.1 != 0) {
            let node = |n: &u64| self.index.get(n).map(|i| used[*i as usize]);
            if let [Some(a), Some(b), Some(c)] = [0, 1, 2].map(|k| node(&triangle[k]))
                && ![a, b, c].contains(&u32::MAX)
            {
                by_surface.entry(*id).or_default().push([a, b, c]);
            }
        }
        let mut surfaces: Vec<_> = by_surface
            .into_iter()
            .map(|(id, triangles)| (group(2, id), triangles))
            .collect();
        surfaces.sort_by_key(|s| s.0.id);
        let mesh = TetMesh::new(nodes, tets).map_err(|source| AnatomyError::Mesh {
            name: name.to_owned(),
            source,
        })?;
        Ok(MeshFile {
            mesh,
            volumes: volumes.into_iter().map(|id| group(3, id)).collect(),
            tet_volume,
            surfaces,
        })
    }
}

/// Number of nodes of Gmsh's element types, by type; 0: unknown.
const NODES_OF_TYPE: [u8; 32] = [
    0, 2, 3, 4, 4, 8, 6, 5, 3, 6, 9, 10, 27, 18, 14, 1, 8, 20, 15, 13, 9, 10, 12, 15, 15, 21, 4, 5,
    6, 20, 35, 56,
];
/// Hexahedra, prisms, pyramids and tetrahedra of higher order: without them the body would have holes.
const BEYOND_LINEAR_TETRAHEDRA: [i64; 11] = [5, 6, 7, 11, 12, 13, 14, 17, 18, 19, 29];
const TRIANGLE: i64 = 2;
const TETRAHEDRON: i64 = 4;

struct Reader<'a> {
    bytes: &'a [u8],
    pos: usize,
    binary: bool,
    section: String,
}

type Parsed<T> = Result<T, String>;

impl Reader<'_> {
    fn file(&mut self) -> Parsed<Raw> {
        let mut raw = Raw::default();
        "$MeshFormat".clone_into(&mut self.section);
        if self.line() != Some("$MeshFormat") {
            return Err("the file does not begin with $MeshFormat".to_owned());
        }
        let version_4 = self.format()?;
        let mut complete = false;
        while let Some(line) = self.next_section() {
            self.section = line;
            match self.section.as_str() {
                "$PhysicalNames" => self.names(&mut raw)?,
                "$Entities" if version_4 => self.entities(&mut raw)?,
                "$Nodes" if version_4 => self.nodes_4(&mut raw)?,
                "$Nodes" => self.nodes_2(&mut raw)?,
                "$Elements" if version_4 => self.elements_4(&mut raw)?,
                "$Elements" => self.elements_2(&mut raw)?,
                _ => {
                    self.skip_section()?;
                    continue;
                }
            }
            complete |= self.section == "$Elements";
            self.end()?;
        }
        if !complete {
            return Err("the file ends before $Elements; it is truncated".to_owned());
        }
        Ok(raw)
    }

    fn format(&mut self) -> Parsed<bool> {
        let line = self.line().unwrap_or_default().to_owned();
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let [version, kind, size] = words[..] else {
            return Err(format!("\"{line}\" is not a version, type and size"));
        };
        let version_4 = match version {
            "2" | "2.1" | "2.2" => false,
            "4.1" => true,
            other => {
                return Err(format!(
                    "version {other} is not supported; save as 2.2 or 4.1"
                ));
            }
        };
        if size != "8" {
            return Err(format!("numbers of {size} bytes are not supported; 8 are"));
        }
        if kind == "1" {
            self.binary = true;
            if self.int()? != 1 {
                return Err("the byte order is not little-endian".to_owned());
            }
        }
        self.end()?;
        Ok(version_4)
    }

    fn names(&mut self, raw: &mut Raw) -> Parsed<()> {
        let n = self.line().unwrap_or_default().trim().to_owned();
        let n: u64 = n.parse().map_err(|_| format!("\"{n}\" is not a count"))?;
        for _ in 0..limited(n)? {
            let line = self.line().ok_or_else(truncated)?;
            let mut parts = line.splitn(3, ' ');
            let mut number = || parts.next().and_then(|w| w.parse::<i32>().ok());
            let (Some(dimension), Some(id)) = (number(), number()) else {
                return Err(format!("\"{line}\" is not a dimension, number and name"));
            };
            let name = parts.next().unwrap_or_default().trim().trim_matches('"');
            raw.names.insert((dimension, id), name.to_owned());
        }
        Ok(())
    }

    fn entities(&mut self, raw: &mut Raw) -> Parsed<()> {
        let mut counts = [0; 4];
        for c in &mut counts {
            *c = limited(self.size()?)?;
        }
        for (dimension, count) in counts.into_iter().enumerate() {
            for _ in 0..count {
                let tag = self.int()? as i32;
                for _ in 0..if dimension == 0 { 3 } else { 6 } {
                    self.double()?;
                }
                for k in 0..limited(self.size()?)? {
                    let group = self.int()? as i32;
                    if k == 0 {
                        raw.entities.insert((dimension as i32, tag), group.abs());
                    }
                }
                if dimension > 0 {
                    for _ in 0..limited(self.size()?)? {
                        self.int()?;
                    }
                }
            }
        }
        Ok(())
    }

    fn nodes_2(&mut self, raw: &mut Raw) -> Parsed<()> {
        for _ in 0..self.count()? {
            let id = self.int()? as u64;
            let p = self.point()?;
            raw.index.insert(id, raw.nodes.len() as u32);
            raw.nodes.push(p);
        }
        Ok(())
    }

    fn nodes_4(&mut self, raw: &mut Raw) -> Parsed<()> {
        let n_blocks = limited(self.size()?)?;
        for _ in 0..3 {
            self.size()?;
        }
        for _ in 0..n_blocks {
            let dimension = self.int()?;
            self.int()?;
            let parametric = self.int()? != 0;
            let n = limited(self.size()?)?;
            let first = raw.nodes.len() as u64;
            for i in 0..n {
                let tag = self.size()?;
                raw.index.insert(tag, limited(first + i)? as u32);
            }
            for _ in 0..n {
                let p = self.point()?;
                raw.nodes.push(p);
                for _ in 0..if parametric { dimension.clamp(0, 3) } else { 0 } {
                    self.double()?;
                }
            }
        }
        Ok(())
    }

    fn elements_2(&mut self, raw: &mut Raw) -> Parsed<()> {
        let n = self.count()?;
        let mut done = 0;
        while done < n {
            if self.binary {
                let (kind, in_block, n_tags) = (self.int()?, self.int()?, self.int()?);
                for _ in 0..limited(in_block as u64)?.max(1) {
                    self.int()?;
                    self.element_2(raw, kind, n_tags)?;
                    done += 1;
                }
            } else {
                self.int()?;
                let (kind, n_tags) = (self.int()?, self.int()?);
                self.element_2(raw, kind, n_tags)?;
                done += 1;
            }
        }
        Ok(())
    }

    fn element_2(&mut self, raw: &mut Raw, kind: i64, n_tags: i64) -> Parsed<()> {
        let mut group = 0;
        for k in 0..limited(n_tags as u64)? {
            let tag = self.int()?;
            if k == 0 {
                group = tag as i32;
            }
        }
        self.element(raw, kind, group, |r| r.int().map(|n| n as u64))
    }

    fn elements_4(&mut self, raw: &mut Raw) -> Parsed<()> {
        let n_blocks = limited(self.size()?)?;
        for _ in 0..3 {
            self.size()?;
        }
        for _ in 0..n_blocks {
            let (dimension, tag, kind) = (self.int()? as i32, self.int()? as i32, self.int()?);
            let group = raw.entities.get(&(dimension, tag)).copied().unwrap_or(0);
            for _ in 0..limited(self.size()?)? {
                self.size()?;
                self.element(raw, kind, group, Self::size)?;
            }
        }
        Ok(())
    }

    fn element(
        &mut self,
        raw: &mut Raw,
        kind: i64,
        group: i32,
        node: impl Fn(&mut Self) -> Parsed<u64>,
    ) -> Parsed<()> {
        let n_nodes = usize::try_from(kind)
            .ok()
            .and_then(|k| NODES_OF_TYPE.get(k))
            .copied()
            .filter(|n| *n > 0)
            .ok_or_else(|| format!("element type {kind} is not known; save linear elements"))?;
        let mut nodes = [0; 4];
        for k in 0..usize::from(n_nodes) {
            let id = node(self)?;
            if let Some(slot) = nodes.get_mut(k) {
                *slot = id;
            }
        }
        match kind {
            TETRAHEDRON => raw.tets.push((nodes, group)),
            TRIANGLE => raw.triangles.push(([nodes[0], nodes[1], nodes[2]], group)),
            _ if BEYOND_LINEAR_TETRAHEDRA.contains(&kind) => {
                return Err(format!(
                    "element type {kind} fills a volume but is no linear tetrahedron; save a tetrahedral mesh of order 1"
                ));
            }
            _ => {}
        }
        Ok(())
    }

    /// The count line of a 2.2 section, which is text even in binary files.
    fn count(&mut self) -> Parsed<u64> {
        let line = self.line().ok_or_else(truncated)?;
        let n = line.trim().parse();
        limited(n.map_err(|_| format!("\"{line}\" is not a count"))?)
    }

    fn point(&mut self) -> Parsed<Vec3> {
        Ok(Vec3::new(self.double()?, self.double()?, self.double()?))
    }

    fn int(&mut self) -> Parsed<i64> {
        if self.binary {
            return self.take().map(|b| i64::from(i32::from_le_bytes(b)));
        }
        self.word("a whole number")
    }

    fn size(&mut self) -> Parsed<u64> {
        if self.binary {
            return self.take().map(u64::from_le_bytes);
        }
        self.word("a count")
    }

    fn double(&mut self) -> Parsed<f64> {
        if self.binary {
            return self.take().map(f64::from_le_bytes);
        }
        self.word("a number")
    }

    fn take<const N: usize>(&mut self) -> Parsed<[u8; N]> {
        let slice = self
            .bytes
            .get(self.pos..self.pos + N)
            .ok_or_else(truncated)?;
        self.pos += N;
        slice.try_into().map_err(|_| truncated())
    }

    fn word<T: std::str::FromStr>(&mut self, what: &str) -> Parsed<T> {
        self.skip_space();
        let rest = &self.bytes[self.pos..];
        let n = rest
            .iter()
            .position(u8::is_ascii_whitespace)
            .unwrap_or(rest.len());
        if n == 0 {
            return Err(truncated());
        }
        let word = String::from_utf8_lossy(&rest[..n.min(40)]);
        let value = word
            .parse()
            .map_err(|_| format!("\"{word}\" at byte {} is not {what}", self.pos))?;
        self.pos += n;
        Ok(value)
    }

    fn skip_space(&mut self) {
        while self
            .bytes
            .get(self.pos)
            .is_some_and(u8::is_ascii_whitespace)
        {
            self.pos += 1;
        }
    }

    /// The next line with anything in it.
    fn line(&mut self) -> Option<&str> {
        self.skip_space();
        let rest = &self.bytes[self.pos..];
        if rest.is_empty() {
            return None;
        }
        let n = rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
        self.pos += (n + 1).min(rest.len());
        std::str::from_utf8(&rest[..n]).ok().map(str::trim_end)
    }

    fn next_section(&mut self) -> Option<String> {
        while let Some(line) = self.line() {
            if line.starts_with('$') {
                return Some(line.trim().to_owned());
            }
        }
        None
    }

    fn end(&mut self) -> Parsed<()> {
        let want = self.section.replacen('$', "$End", 1);
        match self.line() {
            Some(line) if line.trim() == want => Ok(()),
            Some(line) => {
                let line: String = line.chars().take(40).collect();
                Err(format!("\"{line}\" stands where {want} should be"))
            }
            None => Err(truncated()),
        }
    }

    fn skip_section(&mut self) -> Parsed<()> {
        let want = self.section.replacen('$', "$End", 1);
        let found = self.bytes[self.pos..]
            .windows(want.len())
            .position(|w| w == want.as_bytes())
            .ok_or_else(truncated)?;
        self.pos += found + want.len();
        Ok(())
    }
}

fn truncated() -> String {
    "the file ends here; it is truncated".to_owned()
}

fn limited(n: u64) -> Parsed<u64> {
    if n <= MAX_ITEMS {
        Ok(n)
    } else {
        Err(format!("a count of {n} is beyond the limit of {MAX_ITEMS}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: &str =
        "$PhysicalNames\n2\n2 5 \"top\"\n3 7 \"cortical bone\"\n$EndPhysicalNames\n";
    const POINTS: [[f64; 3]; 6] = [
        [9.0, 9.0, 9.0],
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, 1.0, 1.0],
    ];

    fn text_2() -> String {
        let mut s = format!("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n{NAMES}$Nodes\n6\n");
        for (i, [x, y, z]) in POINTS.iter().enumerate() {
            s += &format!("{} {x} {y} {z}\n", 10 + i);
        }
        s += "$EndNodes\n$Elements\n4\n1 15 2 0 1 10\n2 2 2 5 1 12 13 14\n3 4 2 7 1 11 12 13 14\n4 4 2 0 2 12 13 14 15\n$EndElements\n";
        s
    }

    fn text_4() -> String {
        let mut s = format!("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n{NAMES}");
        s += "$Entities\n0 0 1 2\n1 0 0 0 1 1 1 1 5 0\n1 0 0 0 1 1 1 1 7 1 1\n2 0 0 0 1 1 1 0 0\n$EndEntities\n";
        s += "$Nodes\n2 6 10 15\n2 1 0 2\n10\n11\n9 9 9\n0 0 0\n3 1 0 4\n12\n13\n14\n15\n1 0 0\n0 1 0\n0 0 1\n1 1 1\n$EndNodes\n";
        s += "$Elements\n3 3 1 3\n2 1 2 1\n1 12 13 14\n3 1 4 1\n2 11 12 13 14\n3 2 4 1\n3 12 13 14 15\n$EndElements\n";
        s
    }

    fn binary_2() -> Vec<u8> {
        let mut b = b"$MeshFormat\n2.2 1 8\n".to_vec();
        let int = |b: &mut Vec<u8>, v: &[i32]| v.iter().for_each(|i| b.extend(i.to_le_bytes()));
        int(&mut b, &[1]);
        b.extend(format!("\n$EndMeshFormat\n{NAMES}$Nodes\n6\n").bytes());
        for (i, p) in POINTS.iter().enumerate() {
            int(&mut b, &[10 + i as i32]);
            p.iter().for_each(|c| b.extend(c.to_le_bytes()));
        }
        b.extend(b"\n$EndNodes\n$Elements\n3\n");
        int(&mut b, &[2, 1, 2, 1, 5, 1, 12, 13, 14]);
        int(
            &mut b,
            &[4, 2, 2, 2, 7, 1, 11, 12, 13, 14, 3, 0, 2, 12, 13, 14, 15],
        );
        b.extend(b"\n$EndElements\n");
        b
    }

    fn binary_4() -> Vec<u8> {
        let mut b = b"$MeshFormat\n4.1 1 8\n".to_vec();
        let int = |b: &mut Vec<u8>, v: &[i32]| v.iter().for_each(|i| b.extend(i.to_le_bytes()));
        let size = |b: &mut Vec<u8>, v: &[u64]| v.iter().for_each(|i| b.extend(i.to_le_bytes()));
        let double = |b: &mut Vec<u8>, v: &[f64]| v.iter().for_each(|i| b.extend(i.to_le_bytes()));
        int(&mut b, &[1]);
        b.extend(format!("\n$EndMeshFormat\n{NAMES}$Entities\n").bytes());
        size(&mut b, &[0, 0, 1, 2]);
        for (tag, group, bounding) in [(1, Some(5), 0), (1, Some(7), 1), (2, None, 0)] {
            int(&mut b, &[tag]);
            double(&mut b, &[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
            size(&mut b, &[group.map_or(0, |_| 1)]);
            group.iter().for_each(|g| int(&mut b, &[*g]));
            size(&mut b, &[bounding]);
            (0..bounding).for_each(|_| int(&mut b, &[1]));
        }
        b.extend(b"\n$EndEntities\n$Nodes\n");
        size(&mut b, &[1, 6, 10, 15]);
        int(&mut b, &[3, 1, 0]);
        size(&mut b, &[6, 10, 11, 12, 13, 14, 15]);
        POINTS.iter().for_each(|p| double(&mut b, p));
        b.extend(b"\n$EndNodes\n$Elements\n");
        size(&mut b, &[3, 3, 1, 3]);
        int(&mut b, &[2, 1, 2]);
        size(&mut b, &[1, 1, 12, 13, 14]);
        int(&mut b, &[3, 1, 4]);
        size(&mut b, &[1, 2, 11, 12, 13, 14]);
        int(&mut b, &[3, 2, 4]);
        size(&mut b, &[1, 3, 12, 13, 14, 15]);
        b.extend(b"\n$EndElements\n");
        b
    }

    #[test]
    fn all_four_forms_hold_the_same_mesh() {
        let forms = [
            text_2().into_bytes(),
            text_4().into_bytes(),
            binary_2(),
            binary_4(),
        ];
        for (i, bytes) in forms.iter().enumerate() {
            let file = parse_msh(bytes, "jaw.msh").unwrap_or_else(|e| panic!("form {i}: {e}"));
            // The loose first node is left out.
            assert_eq!(file.mesh.nodes().len(), 5, "form {i}");
            assert_eq!(file.mesh.tets(), [[0, 1, 2, 3], [1, 2, 3, 4]]);
            assert!((file.mesh.volume() - 0.5).abs() < 1e-15);
            assert_eq!(file.volumes.len(), 1);
            assert_eq!(
                (file.volumes[0].id, file.volumes[0].name.as_str()),
                (7, "cortical bone")
            );
            assert_eq!(file.tet_volume, [Some(0), None]);
            assert_eq!(file.surfaces.len(), 1);
            assert_eq!(file.surfaces[0].0.name, "top");
            assert_eq!(file.surfaces[0].1, [[1, 2, 3]]);
        }
    }

    #[test]
    fn no_prefix_of_a_file_panics() {
        for bytes in [
            text_2().into_bytes(),
            text_4().into_bytes(),
            binary_2(),
            binary_4(),
        ] {
            let whole = bytes.len() - "\n$EndElements\n".len();
            for n in 0..whole {
                assert!(parse_msh(&bytes[..n], "jaw.msh").is_err(), "{n} bytes");
            }
        }
    }

    #[test]
    fn faults_are_told_in_one_line() {
        let refusal = |s: String| parse_msh(s.as_bytes(), "jaw.msh").unwrap_err().to_string();
        assert_eq!(
            refusal(text_2().replace("2.2 0 8", "3.1 0 8")),
            "jaw.msh is not a usable Gmsh .msh file: in section $MeshFormat: version 3.1 is not supported; save as 2.2 or 4.1"
        );
        assert!(
            refusal(text_2().replace("11 12 13 14\n", "11 12 13 99\n"))
                .contains("tetrahedron 0 names node 99")
        );
        assert!(
            refusal(text_2().replace("11 12 13 14\n", "11 13 12 14\n"))
                .contains("must be positive")
        );
        assert!(refusal(text_4().replace("0 0 0\n3 1", "0 x 0\n3 1")).contains("\"x\" at byte"));
        assert!(
            refusal(text_2().replace("11 0 0 0", "11 0 nan 0")).contains("not a finite number")
        );
        assert!(
            refusal(text_2().replace("4 4 2 0 2 12 13 14 15", "4 7 2 0 2 12 13 14 15 11"))
                .contains("element type 7 fills a volume")
        );
    }
}
