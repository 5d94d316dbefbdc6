use super::Contact;

/// Where the bone's points cling to one tool: linear friction after McKenna & Zeltzer 1990.
///
/// A point that stays in touch is tied by a tangential spring to the place of the tool where it first touched, in the tool's
/// frame, so that the anchor moves with the tool and the point with the bone. Indexed by stable point id. Allocates only at
/// construction; ids beyond the capacity slide without friction.
#[derive(Clone, Debug)]
pub struct Anchors {
    entries: Vec<Entry>,
    epoch: u32,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    epoch: u32,
    position: [f32; 3],
}

impl Anchors {
    /// No anchors yet, room for point ids below `n_ids`: allow for the points that the crack will add.
    pub fn with_capacity(n_ids: usize) -> Self {
        let none = Entry {
            epoch: 0,
            position: [0.0; 3],
        };
        Self {
            entries: vec![none; n_ids],
            epoch: 1,
        }
    }

    /// Where point `id` clings, if it was in touch at the last commit.
    #[inline]
    pub fn get(&self, id: u32) -> Option<[f32; 3]> {
        let entry = self.entries.get(id as usize)?;
        (entry.epoch == self.epoch).then_some(entry.position)
    }

    /// Ends a step: the points in `contacts` cling where the response said, all others let go.
    pub fn commit(&mut self, contacts: &[Contact]) {
        self.let_go();
        for contact in contacts {
            if let Some(entry) = self.entries.get_mut(contact.id as usize) {
                *entry = Entry {
                    epoch: self.epoch,
                    position: contact.anchor,
                };
            }
        }
    }

    /// Releases every point.
    pub fn let_go(&mut self) {
        self.epoch = self.epoch.wrapping_add(1);
        if self.epoch == 0 {
            self.entries.iter_mut().for_each(|e| e.epoch = 0);
            self.epoch = 1;
        }
    }
}
