mod scene;
use super::*;
use scene::{Strengths, draw};

#[test]
#[ignore]
fn study() {
    for strengths in [Strengths::Physical, Strengths::Alike] {
        for snr in [0.0, 0.75, 1.0, 1.5, 2.0] {
            let (mut found, mut squares, mut evidence, mut like, mut at_truth, mut time) = (0, 0.0, 0.0, 0.0, 0.0, 0.0);
            let mut far = 0;
            let n = 20;
            for seed in 0..n {
                let (profiles, room, hidden) = draw(8, snr, strengths, 5000 + seed);
                let t = std::time::Instant::now();
                let Some(faint) = likeliest(&profiles, &room) else { println!("none"); continue };
                time += t.elapsed().as_secs_f64();
                let longest_m = profiles.iter().map(Profile::end_m).fold(0.0, f64::max);
                let domain = Domain { centre: Point::origin(), half_m: longest_m, dimensions: 3 };
                let all = Likelihood::new(&profiles, &room, &domain);
                let off = faint.point - hidden;
                if off.norm() > 0.2 { far += 1; }
                let is_found = faint.evidence > 6.9;
                if is_found && off.norm() < 0.2 {
                found += 1;
                squares += off.dot(&(faint.covariance.try_inverse().unwrap() * off));
                }
                evidence += faint.evidence / n as f64;
                like += faint.likelihood / n as f64;
                at_truth += all.place(&hidden).unwrap().most() / n as f64;
            }
            println!("{strengths:?} {snr}: found {found} far {far} nse {:.2} evidence {evidence:.1} like {like:.1} truth {at_truth:.1} theory {:.1} {:.2} s", squares / found as f64, 32.0 * snr * snr, time / n as f64);
        }
    }
}
