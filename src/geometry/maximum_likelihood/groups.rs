//! Numbers that are joined into groups one by one (union-find).

/// Groups of the numbers from 0 on.
pub struct Groups {
    /// Of each number another one of its group; the least one stands for itself.
    root: Vec<usize>,
}

impl Groups {
    /// So many numbers, each a group.
    pub fn new(count: usize) -> Self {
        Self { root: (0..count).collect() }
    }

    fn find(&mut self, mut number: usize) -> usize {
        while self.root[number] != number {
            self.root[number] = self.root[self.root[number]];
            number = self.root[number];
        }
        number
    }

    /// Makes one group of those of two numbers.
    pub fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.find(a), self.find(b));
        self.root[a.max(b)] = a.min(b);
    }

    /// All groups by their least numbers, each in ascending order.
    pub fn sets(mut self) -> Vec<Vec<usize>> {
        let mut sets = vec![Vec::new(); self.root.len()];
        (0..self.root.len()).for_each(|number| sets[self.find(number)].push(number));
        sets.retain(|set| !set.is_empty());
        sets
    }
}
