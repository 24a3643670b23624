//! Counts what each address holds of a server, so that no one takes all of it.

use std::{
    collections::BTreeMap,
    net::{IpAddr, Ipv6Addr},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

/// The network part of an IPv6 address: a site is assigned all addresses that begin with it.
const IPV6_NETWORK: u128 = u128::MAX << 64;

/// Places of which each address may hold so many.
#[derive(Debug)]
pub(crate) struct PerAddress {
    most: usize,
    counts: Mutex<BTreeMap<IpAddr, usize>>,
}

/// A place; given back when it is dropped.
#[derive(Debug)]
pub(crate) struct Place {
    places: Arc<PerAddress>,
    holder: IpAddr,
}

impl PerAddress {
    /// `most` places for each address.
    pub(crate) fn new(most: usize) -> Arc<Self> {
        Arc::new(Self { most, counts: Mutex::default() })
    }

    /// One more place for `address`, if it may have it.
    pub(crate) fn take(self: &Arc<Self>, address: IpAddr) -> Option<Place> {
        let holder = holder(address);
        let mut counts = self.lock();
        if counts.get(&holder).is_some_and(|count| *count >= self.most) {
            return None;
        }
        *counts.entry(holder).or_default() += 1;
        Some(Place { places: self.clone(), holder })
    }

    /// Places that `address` has.
    pub(crate) fn count(&self, address: IpAddr) -> usize {
        self.lock().get(&holder(address)).copied().unwrap_or(0)
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<IpAddr, usize>> {
        // Whoever panicked with it left counts that are still in order.
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut counts = self.places.lock();
        if let Some(count) = counts.get_mut(&self.holder) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.holder);
            }
        }
    }
}

/// Who has `address`: itself, or its part of the network where it is IPv6.
fn holder(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() & IPV6_NETWORK).into(),
        address => address,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_holds_so_many_places_until_it_gives_them_back() {
        let places = PerAddress::new(2);
        let address = |text: &str| text.parse::<IpAddr>().unwrap();
        let taken = |text: &str| places.take(address(text));
        let first = taken("192.0.2.1");
        // The same address as a socket for both families has it.
        let second = taken("::ffff:192.0.2.1");
        assert!(first.is_some() && second.is_some() && taken("192.0.2.1").is_none());
        assert_eq!((places.count(address("192.0.2.1")), places.count(address("192.0.2.2"))), (2, 0));
        let other = taken("192.0.2.2");
        drop(second);
        assert!(other.is_some() && taken("192.0.2.1").is_some());
        let site = (taken("2001:db8::1"), taken("2001:db8::2"));
        assert!(taken("2001:db8::3").is_none() && taken("2001:db8:0:1::3").is_some());
        drop((site, other, first));
        assert!(places.lock().is_empty());
    }
}
