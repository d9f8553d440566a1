//! One function over many items on the cores that there are: fits, candidates, files. Called by identification,
//! diagnosis, campaigns and questions to a tree of runs; never by anything beside a moving table. Results do not depend
//! on how many threads there were.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Cores that this process may use, at least one.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Results of a function over a list, in the list's order, on at most so many threads; each takes the next item when it
/// is free. A panic of the function goes on in the caller.
pub fn map<T: Sync, R: Send>(items: &[T], threads: usize, work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let next = AtomicUsize::new(0);
    let share = || {
        let mut mine = Vec::new();
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(i) else { return mine };
            mine.push((i, work(item)));
        }
    };
    let mut done: Vec<(usize, R)> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads.clamp(1, items.len().max(1))).map(|_| scope.spawn(share)).collect();
        let joined = threads.into_iter().map(|thread| thread.join());
        joined.flat_map(|part| part.unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
    });
    done.sort_by_key(|(i, _)| *i);
    done.into_iter().map(|(_, result)| result).collect()
}

/// The same where a state is costly to make: items in turn share one until they weigh enough together, and what weighs
/// most begins first. `None` when a state or a result is.
pub fn map_with<T: Sync, S, R: Send>(
    items: &[T],
    weight: impl Fn(&T) -> usize,
    state: impl Fn() -> Option<S> + Sync,
    work: impl Fn(&mut S, &T) -> Option<R> + Sync,
) -> Option<Vec<R>> {
    let weights: Vec<usize> = items.iter().map(weight).collect();
    let mut chunks = shared(&weights);
    chunks.sort_by_key(|chunk| std::cmp::Reverse(weights[chunk.clone()].iter().sum::<usize>()));
    let done = map(&chunks, cores(), |chunk| {
        let mut state = state()?;
        let results = items[chunk.clone()].iter().map(|item| work(&mut state, item));
        Some((chunk.start, results.collect::<Option<Vec<R>>>()?))
    });
    let mut done = done.into_iter().collect::<Option<Vec<_>>>()?;
    done.sort_by_key(|(start, _)| *start);
    Some(done.into_iter().flat_map(|(_, results)| results).collect())
}

/// Items in a row that share a state: at most so many, and not more than such a part of the whole weight.
const TOGETHER: usize = 4;
const PART: usize = 16;

fn shared(weights: &[usize]) -> Vec<Range<usize>> {
    let most = weights.iter().sum::<usize>() / PART;
    let mut chunks: Vec<Range<usize>> = Vec::new();
    let mut together = 0;
    for (i, weight) in weights.iter().enumerate() {
        match chunks.last_mut() {
            Some(last) if last.len() < TOGETHER && together + weight <= most => {
                last.end = i + 1;
                together += weight;
            }
            _ => {
                chunks.push(i..i + 1);
                together = *weight;
            }
        }
    }
    chunks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_stand_in_the_order_of_their_items_whatever_the_number_of_threads() {
        let items: Vec<u64> = (0..200).collect();
        let expected: Vec<u64> = items.iter().map(|n| n * n).collect();
        for threads in [0, 1, 3, 500] {
            assert_eq!(map(&items, threads, |n| n * n), expected);
        }
        assert!(map(&[] as &[u64], 4, |n| *n).is_empty());
    }

    #[test]
    fn items_that_share_a_state_do_so_in_turn_and_one_without_a_result_leaves_none() {
        let items: Vec<u64> = (0..50).collect();
        let count = |seen: &mut u64, n: &u64| {
            *seen += 1;
            Some((*n, *seen))
        };
        let alike = |_: &u64| 1;
        let expected: Vec<_> = items.iter().map(|n| (*n, n % 3 + 1)).collect();
        assert_eq!(map_with(&items, alike, || Some(0), count), Some(expected));
        assert_eq!(map_with(&items, alike, || Some(()), |(), n| (*n != 30).then_some(*n)), None);
        assert_eq!(map_with(&items, alike, || None::<()>, |(), n| Some(*n)), None);
    }

    #[test]
    fn what_weighs_much_has_a_state_of_its_own() {
        let mut weights = vec![1; 64];
        weights[1] = 40;
        let chunks = shared(&weights);
        assert_eq!(chunks[..3], [0..1, 1..2, 2..6]);
        assert!(chunks.windows(2).all(|pair| pair[0].end == pair[1].start));
        assert_eq!(chunks.last().map(|last| last.end), Some(64));
        assert!(shared(&[]).is_empty());
    }
}
