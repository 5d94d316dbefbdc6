//! Bad splits by rule: which named regions of the bone ended on which fragment.
//!
//! Published types: 1A-F buccal plate, 2A-B lingual plate, 3 coronoid process, 4 condylar neck. The letters' published drawings were
//! not at hand: letters here follow this program's own rule, by which part of the plate is lost and where it went, and every
//! reason says so.
use super::path::Plane;
use osteotome_anatomy::{Patient, Side};
use osteotome_mechanics::geometry::{MeshDistance, Vec3};
use serde::Serialize;
use std::collections::BTreeMap;

/// A named region of the operated side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// Outer cortex from the buccal cut half way back to the lingula.
    BuccalFront,
    /// Outer cortex from there to the lingula.
    BuccalBack,
    /// Inner cortex from the buccal cut half way back to the lingula.
    LingualFront,
    /// Inner cortex from there to the lingula.
    LingualBack,
    /// The condyle's head and what is above the neck.
    CondyleNeck,
    /// The tip of the coronoid process.
    Coronoid,
    /// The lower border behind the buccal cut.
    LowerBorder,
    /// The rear border of the ramus: by definition of the proximal fragment.
    Ramus,
    /// The chin: by definition of the tooth-bearing, distal fragment.
    Chin,
}

impl Region {
    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::BuccalFront => "front half of the buccal plate",
            Self::BuccalBack => "rear half of the buccal plate",
            Self::LingualFront => "front half of the lingual plate",
            Self::LingualBack => "rear half of the lingual plate",
            Self::CondyleNeck => "condyle above its neck",
            Self::Coronoid => "coronoid process",
            Self::LowerBorder => "lower border",
            Self::Ramus => "rear border of the ramus",
            Self::Chin => "chin",
        }
    }
}

/// Points on the bone's surface, by region.
pub type Regions = BTreeMap<Region, Vec<Vec3>>;

/// Finds the regions; `None` for a patient without landmarks.
pub fn regions(patient: &Patient) -> Option<Regions> {
    let marks = patient.landmarks.as_ref()?;
    let side = match patient.osteotomy.side {
        Side::Right => &marks.right,
        Side::Left => &marks.left,
    };
    let sign = patient.osteotomy.side.sign();
    let plane = Plane::planned(&patient.osteotomy);
    let size = (side.condyle_top - side.gonion).norm() / 55.0;
    let (front, back) = (side.lower_border.y, side.lingula.y);
    let middle = 0.5 * (front + back);
    let rear = 0.5 * (side.condyle_centre + side.gonion);
    let neck = side.condyle_centre.z.min(side.sigmoid_notch.z) + 2.0 * size;
    let region = |p: &Vec3, normal: &Vec3| -> Option<Region> {
        let near = |q: &Vec3, mm: f64| (p - q).norm() < mm * size;
        if near(&marks.menton, 12.0) {
            return Some(Region::Chin);
        }
        if p.x * sign < 0.3 * side.gonion.x.abs() {
            return None;
        }
        if near(&side.condyle_centre, 9.0) && p.z > neck {
            return Some(Region::CondyleNeck);
        }
        if near(&side.coronoid_tip, 8.0) {
            return Some(Region::Coronoid);
        }
        if near(&rear, 9.0) {
            return Some(Region::Ramus);
        }
        let within = p.y > front + 2.0 * size && p.y < back && p.z < side.lingula.z;
        if !within {
            return None;
        }
        let w = (p.y - side.lower_border.y) / (side.gonion.y - side.lower_border.y);
        if p.z < side.lower_border.lerp(&side.gonion, w).z + 4.0 * size {
            return Some(Region::LowerBorder);
        }
        let off = plane.off(p);
        let facing = normal.x * sign;
        match (
            p.y < middle,
            facing > 0.3 && off > 0.0,
            facing < -0.3 && off < 0.0,
        ) {
            (true, true, _) => Some(Region::BuccalFront),
            (false, true, _) => Some(Region::BuccalBack),
            (true, _, true) => Some(Region::LingualFront),
            (false, _, true) => Some(Region::LingualBack),
            _ => None,
        }
    };
    let mut found = Regions::new();
    let surface = MeshDistance::new(patient.surface.clone());
    for (p, normal) in patient
        .surface
        .vertices
        .iter()
        .zip(surface.vertex_normals())
    {
        if let Some(region) = region(p, normal) {
            found.entry(region).or_default().push(*p);
        }
    }
    Some(found)
}

/// For each region, the share of it on each fragment.
pub type Layout = BTreeMap<Region, BTreeMap<u32, f64>>;

/// Where the regions lie, by the fragment of a point.
pub fn layout(regions: &Regions, fragment: impl Fn(&Vec3) -> u32) -> Layout {
    let shares = |points: &Vec<Vec3>| {
        let mut shares = BTreeMap::new();
        for p in points {
            *shares.entry(fragment(p)).or_insert(0.0) += 1.0 / points.len() as f64;
        }
        shares
    };
    regions
        .iter()
        .map(|(r, points)| (*r, shares(points)))
        .collect()
}

/// The verdict.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BadSplit {
    /// `1A` to `1F`, `2A`, `2B`, `3` or `4`; `null` for none.
    pub kind: Option<String>,
    /// Why, in words.
    pub reason: String,
    /// The proximal fragment (with the ramus' rear border) and the distal one (with the chin).
    pub fragments: [u32; 2],
    /// Share of each region on the proximal, the distal and other fragments.
    pub regions: BTreeMap<Region, [f64; 3]>,
}

/// A region has gone where more than this share of it is.
const MOST: f64 = 0.5;

/// The fragment with most of a region.
pub fn home(layout: &Layout, region: Region) -> Option<u32> {
    let shares = layout.get(&region)?;
    shares
        .iter()
        .max_by(|a, b| a.1.total_cmp(b.1))
        .map(|s| *s.0)
}

/// Applies the rule; `None` where ramus and chin are not apart, or their regions are empty.
pub fn classify(layout: &Layout) -> Option<BadSplit> {
    let proximal = home(layout, Region::Ramus)?;
    let distal = home(layout, Region::Chin)?;
    if proximal == distal {
        return None;
    }
    let of = |region: Region| -> [f64; 3] {
        let mut split = [0.0; 3];
        for (fragment, share) in layout.get(&region).into_iter().flatten() {
            let k = [proximal, distal].iter().position(|f| f == fragment);
            split[k.unwrap_or(2)] += share;
        }
        split
    };
    let mut found = vec![];
    if of(Region::CondyleNeck)[1] + of(Region::CondyleNeck)[2] > MOST {
        found.push(("4".to_owned(), lost(Region::CondyleNeck, "the ramus")));
    }
    if of(Region::Coronoid)[1] + of(Region::Coronoid)[2] > MOST {
        found.push(("3".to_owned(), lost(Region::Coronoid, "the ramus")));
    }
    found.extend(buccal(of(Region::BuccalFront), of(Region::BuccalBack)));
    found.extend(lingual(of(Region::LingualFront), of(Region::LingualBack)));
    let reason = if found.is_empty() {
        "Condyle, coronoid process and buccal plate are on the proximal fragment, the lingual plate is on the tooth-bearing one.".to_owned()
    } else {
        let reasons: Vec<&str> = found.iter().map(|f| f.1.as_str()).collect();
        reasons.join(" ")
    };
    Some(BadSplit {
        kind: found.first().map(|f| f.0.clone()),
        reason,
        fragments: [proximal, distal],
        regions: layout.keys().map(|r| (*r, of(*r))).collect(),
    })
}

fn lost(region: Region, from: &str) -> String {
    format!("The {} has come off {from}.", region.name())
}

const OWN_LETTER: &str = "The letter follows osteotome's own rule, not the published drawings.";

/// A and B: front half, C and D: rear half, E and F: all of it; the first of each as a loose piece, the second left on the distal fragment.
fn buccal(front: [f64; 3], back: [f64; 3]) -> Option<(String, String)> {
    let gone = |s: &[f64; 3]| s[1] + s[2] > MOST;
    let (part, first, share) = match (gone(&front), gone(&back)) {
        (false, false) => return None,
        (true, false) => ("front half of the buccal plate", 'A', front),
        (false, true) => ("rear half of the buccal plate", 'C', back),
        (true, true) => ("buccal plate", 'E', [0, 1, 2].map(|k| front[k] + back[k])),
    };
    let is_loose = share[2] > share[1];
    let letter = char::from(first as u8 + u8::from(!is_loose));
    let place = if is_loose {
        "has broken off as a loose piece"
    } else {
        "has stayed on the tooth-bearing fragment"
    };
    Some((
        format!("1{letter}"),
        format!("The {part} {place}. {OWN_LETTER}"),
    ))
}

/// A: a loose piece, B: gone with the proximal fragment.
fn lingual(front: [f64; 3], back: [f64; 3]) -> Option<(String, String)> {
    let gone = |s: &[f64; 3]| s[0] + s[2] > MOST;
    if !gone(&front) && !gone(&back) {
        return None;
    }
    let (own, loose) = [&front, &back]
        .into_iter()
        .filter(|s| gone(s))
        .fold((0.0, 0.0), |sum, s| (sum.0 + s[0], sum.1 + s[2]));
    let (letter, place) = if loose > own {
        ('A', "has broken off as a loose piece")
    } else {
        ('B', "has gone with the proximal fragment")
    };
    Some((
        format!("2{letter}"),
        format!("Half of the lingual plate or more {place}. {OWN_LETTER}"),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteotome_anatomy::{MeshSource, PatientSpec};

    struct Jaw {
        patient: Patient,
        regions: Regions,
    }

    fn jaw(side: Side) -> Jaw {
        let spec = PatientSpec {
            mesh: MeshSource::Nodes(600),
            side: Some(side),
            shell_points: 2000,
            ..PatientSpec::default()
        };
        let patient = Patient::build(&spec, &mut |_, _| {}).unwrap();
        let regions = regions(&patient).unwrap();
        Jaw { patient, regions }
    }

    impl Jaw {
        /// The split as planned: 1 lateral of the plane and behind the buccal cut, or above the medial cut; else 0.
        fn good(&self, p: &Vec3) -> u32 {
            let marks = self.patient.landmarks.as_ref().unwrap();
            let (side, sign) = match self.patient.osteotomy.side {
                Side::Right => (&marks.right, -1.0),
                Side::Left => (&marks.left, 1.0),
            };
            let plane = Plane::planned(&self.patient.osteotomy);
            let is_behind = p.y > side.lower_border.y && p.x * sign > 0.0;
            let is_lateral = plane.off(p) > 0.0 || p.z > side.lingula.z || p.y > side.lingula.y;
            u32::from(is_behind && is_lateral)
        }

        fn region_of(&self, p: &Vec3) -> Option<Region> {
            let holds = |points: &Vec<Vec3>| points.iter().any(|q| q == p);
            self.regions.iter().find(|r| holds(r.1)).map(|r| *r.0)
        }

        /// The planned split, but with these regions on another fragment.
        fn verdict(&self, but: &[(Region, u32)]) -> BadSplit {
            let fragment = |p: &Vec3| {
                let region = self.region_of(p);
                let moved = but.iter().find(|b| Some(b.0) == region);
                moved.map_or_else(|| self.good(p), |b| b.1)
            };
            classify(&layout(&self.regions, fragment)).unwrap()
        }
    }

    #[test]
    fn each_published_type_is_told_by_its_fragmentation() {
        use Region::{BuccalBack, BuccalFront, CondyleNeck, Coronoid, LingualBack, LingualFront};
        const DISTAL: u32 = 0;
        const PROXIMAL: u32 = 1;
        const LOOSE: u32 = 2;
        for side in [Side::Right, Side::Left] {
            let jaw = jaw(side);
            let good = jaw.verdict(&[]);
            assert_eq!(good.kind, None, "{}", good.reason);
            assert_eq!(good.fragments, [1, 0]);
            assert_eq!(good.regions.len(), 9, "{:?}", good.regions.keys());
            type Case<'a> = (&'a [(Region, u32)], &'a str, &'a str);
            let cases: [Case; 10] = [
                (
                    &[(BuccalFront, LOOSE)],
                    "1A",
                    "front half of the buccal plate has broken off",
                ),
                (
                    &[(BuccalFront, DISTAL)],
                    "1B",
                    "stayed on the tooth-bearing",
                ),
                (
                    &[(BuccalBack, LOOSE)],
                    "1C",
                    "rear half of the buccal plate",
                ),
                (
                    &[(BuccalBack, DISTAL)],
                    "1D",
                    "rear half of the buccal plate",
                ),
                (
                    &[(BuccalFront, LOOSE), (BuccalBack, LOOSE)],
                    "1E",
                    "The buccal plate has broken",
                ),
                (
                    &[(BuccalFront, DISTAL), (BuccalBack, DISTAL)],
                    "1F",
                    "The buccal plate has stayed",
                ),
                (
                    &[(LingualBack, LOOSE)],
                    "2A",
                    "lingual plate or more has broken off",
                ),
                (
                    &[(LingualFront, PROXIMAL), (LingualBack, PROXIMAL)],
                    "2B",
                    "with the proximal",
                ),
                (&[(Coronoid, LOOSE)], "3", "coronoid process has come off"),
                (
                    &[(CondyleNeck, LOOSE)],
                    "4",
                    "condyle above its neck has come off",
                ),
            ];
            for (but, kind, reason) in cases {
                let found = jaw.verdict(but);
                assert_eq!(found.kind.as_deref(), Some(kind), "{}", found.reason);
                assert!(found.reason.contains(reason), "{}", found.reason);
                assert_eq!(found.reason.contains("own rule"), kind.len() == 2);
            }
            // Of two, the one nearest to the joint comes first and both are told.
            let both = jaw.verdict(&[(CondyleNeck, DISTAL), (BuccalFront, LOOSE)]);
            assert_eq!(both.kind.as_deref(), Some("4"));
            assert!(both.reason.contains("buccal plate"));
        }
    }

    #[test]
    fn a_whole_jaw_has_no_verdict() {
        let jaw = jaw(Side::Right);
        assert_eq!(classify(&layout(&jaw.regions, |_| 0)), None);
        assert_eq!(classify(&Layout::new()), None);
    }
}
