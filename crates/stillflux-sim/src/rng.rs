//! Seeded noise: xoshiro256++ filled by SplitMix64, Gaussian by the polar method. Same seed, same run.

#[derive(Clone, Copy, Debug)]
pub(crate) struct Rng {
    s: [u64; 4],
    spare: Option<f64>,
}

impl Rng {
    pub fn new(seed: u64) -> Self {
        let mut z = seed;
        let s = std::array::from_fn(|_| {
            z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut x = z;
            x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            x ^ (x >> 31)
        });
        Self { s, spare: None }
    }

    fn next(&mut self) -> u64 {
        let s = &mut self.s;
        let out = s[0].wrapping_add(s[3]).rotate_left(23).wrapping_add(s[0]);
        let t = s[1] << 17;
        s[2] ^= s[0];
        s[3] ^= s[1];
        s[1] ^= s[2];
        s[0] ^= s[3];
        s[2] ^= t;
        s[3] = s[3].rotate_left(45);
        out
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        0.5 + 0.5 * self.signed()
    }

    /// Uniform in [-1, 1).
    fn signed(&mut self) -> f64 {
        ((self.next() as i64) >> 11) as f64 * (1.0 / (1u64 << 52) as f64)
    }

    /// Standard normal.
    pub fn gauss(&mut self) -> f64 {
        if let Some(g) = self.spare.take() {
            return g;
        }
        loop {
            let (u, v) = (self.signed(), self.signed());
            let r = u * u + v * v;
            if r > 0.0 && r < 1.0 {
                let k = (-2.0 * libm::log(r) / r).sqrt();
                self.spare = Some(k * v);
                return k * u;
            }
        }
    }
}
