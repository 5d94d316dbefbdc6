//! Room for fragments: how much, and in how many bands of rows the frame is drawn so that it suffices.
use super::device::Fault;

/// Side of a tile with a counter of its own, in samples; as in append.wgsl.
const TILE: u32 = 64;
/// Words between two counters: a cache line.
pub const LINE: u32 = 16;
/// Words of a fragment.
pub const NODE: u32 = 3;

/// How much room there is for fragments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Room {
    /// Each tile's own.
    pub of_tile: u32,
    /// What all tiles share once their own is full.
    pub shared: u32,
    /// All together at most.
    pub most: u32,
}

/// How a frame is cut into bands that use the same room one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bands {
    /// Samples across and down.
    pub size: [u32; 2],
    /// Rows of a band, whole tiles.
    pub rows: u32,
}

impl Bands {
    pub fn whole(size: [u32; 2]) -> Self {
        Self {
            size,
            rows: size[1].next_multiple_of(TILE),
        }
    }

    /// First row of each band.
    pub fn starts(self) -> impl Iterator<Item = u32> {
        (0..self.size[1]).step_by(self.rows as usize)
    }

    pub fn tiles(self) -> u32 {
        self.size[0].div_ceil(TILE) * (self.rows / TILE)
    }

    fn halved(self) -> Option<Self> {
        let rows = (self.rows / 2).next_multiple_of(TILE);
        (rows < self.rows).then_some(Self { rows, ..self })
    }
}

impl Room {
    /// One layer and a half of each tile, and half of that for all.
    pub fn usual(most: u32) -> Self {
        Self {
            of_tile: TILE * TILE * 3 / 2,
            shared: 1 << 18,
            most,
        }
    }

    /// Where the shared places start: the tiles' own take at most half of all.
    pub fn spill(self, bands: Bands) -> u32 {
        self.own(bands) * bands.tiles()
    }

    /// A tile's own places.
    pub fn own(self, bands: Bands) -> u32 {
        self.of_tile.min(self.most / 2 / bands.tiles())
    }

    pub fn capacity(self, bands: Bands) -> u32 {
        (self.spill(bands) + self.shared).min(self.most)
    }

    /// After a frame of which `spilled` fragments asked for shared places: `None` if all found one, else what to try next.
    pub fn grown(self, bands: Bands, spilled: u32) -> Result<Option<(Self, Bands)>, Fault> {
        if self.spill(bands).saturating_add(spilled) <= self.capacity(bands) {
            return Ok(None);
        }
        let shared = spilled.saturating_add(spilled / 4);
        if self.spill(bands).saturating_add(shared) <= self.most {
            return Ok(Some((Self { shared, ..self }, bands)));
        }
        // Every place there is, for fewer rows at a time.
        let all = Self {
            shared: self.most,
            ..self
        };
        let halved = if self.shared < self.most {
            bands
        } else {
            bands.halved().ok_or(Fault::TooLarge)?
        };
        Ok(Some((all, halved)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_grows_then_bands_shrink_then_it_is_too_large() {
        let mut bands = Bands::whole([128, 200]);
        let mut room = Room {
            of_tile: 10,
            shared: 10,
            most: 1000,
        };
        assert_eq!((bands.rows, bands.tiles(), room.spill(bands)), (256, 8, 80));
        assert_eq!(room.grown(bands, 10), Ok(None));
        let (grown, same) = room.grown(bands, 400).unwrap().unwrap();
        assert_eq!((grown.shared, same), (500, bands));
        assert_eq!(grown.grown(bands, 400), Ok(None));
        (room, bands) = grown.grown(bands, 900).unwrap().unwrap();
        assert_eq!((room.capacity(bands), bands.rows), (1000, 256));
        assert_eq!(room.grown(bands, 900), Ok(None));
        for rows in [128, 64] {
            (room, bands) = room.grown(bands, 2000).unwrap().unwrap();
            assert_eq!(bands.rows, rows);
        }
        assert_eq!(bands.starts().collect::<Vec<_>>(), [0, 64, 128, 192]);
        assert_eq!(room.grown(bands, 2000), Err(Fault::TooLarge));
    }
}
