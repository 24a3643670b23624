//! Names the worlds in which clusters show one of several versions, and keeps the distortion of each.
//!
//! A level that replaces the one below it is another version of its cluster, and so is a level that adds
//! Gaussians. A cluster with one version is always the same.

use super::CounterfactualError;

/// Which group each version of each cluster is: versions of one cluster follow each other, clusters too.
///
/// ```
/// use render_host::counterfactual::Versions;
///
/// // Cluster 0 is the background, cluster 1 has versions 0 (absent), 1 (base level) and 2 (refined).
/// let versions = Versions::new(&[1, 3])?;
/// assert_eq!((versions.groups(), versions.group(1, 2)), (4, 3));
/// # Ok::<(), render_host::counterfactual::CounterfactualError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Versions {
    /// Group of version 0 of each cluster, then the number of groups.
    starts: Vec<u32>,
    /// Cluster of each group.
    clusters: Vec<u32>,
}

impl Versions {
    /// Clusters with `counts` versions, at least one each.
    ///
    /// # Errors
    /// A cluster without a version.
    pub fn new(counts: &[u32]) -> Result<Self, CounterfactualError> {
        let (mut starts, mut clusters) = (vec![0], Vec::new());
        for (cluster, &count) in counts.iter().enumerate() {
            if count == 0 {
                return Err(CounterfactualError::NoVersion { cluster });
            }
            clusters.resize(clusters.len() + count as usize, cluster as u32);
            starts.push(clusters.len() as u32);
        }
        Ok(Self { starts, clusters })
    }

    /// Number of clusters.
    pub fn clusters(&self) -> usize {
        self.starts.len() - 1
    }

    /// Number of versions of `cluster`.
    pub fn count(&self, cluster: usize) -> usize {
        (self.starts[cluster + 1] - self.starts[cluster]) as usize
    }

    /// Number of groups: versions of all clusters.
    pub fn groups(&self) -> usize {
        self.clusters.len()
    }

    /// The group that `version` of `cluster` is.
    pub fn group(&self, cluster: usize, version: usize) -> usize {
        self.starts[cluster] as usize + version
    }

    /// Cluster and version of `group`.
    pub(super) fn of(&self, group: u32) -> (u32, u32) {
        let cluster = self.clusters[group as usize];
        (cluster, group - self.starts[cluster as usize])
    }

    /// Each context must name a version of every cluster.
    pub(super) fn check(&self, contexts: &[Vec<u32>]) -> Result<(), CounterfactualError> {
        let needed = self.clusters();
        for context in contexts {
            let found = context.len();
            if found != needed {
                return Err(CounterfactualError::Context { found, needed });
            }
            for (cluster, &version) in context.iter().enumerate() {
                let count = self.count(cluster);
                if version as usize >= count {
                    return Err(CounterfactualError::Version { cluster, version, count });
                }
            }
        }
        Ok(())
    }
}

/// Distortion of each context, and with any one cluster at each of its versions.
#[derive(Clone, Debug, PartialEq)]
pub struct Distortions {
    versions: Versions,
    /// Of each context.
    base: Vec<f64>,
    /// Context by context, group by group.
    of: Vec<f64>,
}

impl Distortions {
    /// Those of contexts whose distortions are `base`, before any other version is known.
    pub(super) fn new(versions: &Versions, base: Vec<f64>) -> Self {
        let of = base.iter().flat_map(|&d| std::iter::repeat_n(d, versions.groups())).collect();
        Self { versions: versions.clone(), base, of }
    }

    pub(super) fn set(&mut self, context: usize, group: usize, distortion: f64) {
        self.of[context * self.versions.groups() + group] = distortion;
    }

    /// Distortion of `context`.
    pub fn of_context(&self, context: usize) -> f64 {
        self.base[context]
    }

    /// Distortion of `context` with `cluster` at `version`, all else as in the context.
    pub fn of(&self, context: usize, cluster: usize, version: usize) -> f64 {
        self.of[context * self.versions.groups() + self.versions.group(cluster, version)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_are_numbered_cluster_by_cluster() {
        let versions = Versions::new(&[1, 3, 2]).unwrap();
        assert_eq!((versions.clusters(), versions.groups(), versions.count(1)), (3, 6, 3));
        for cluster in 0..3 {
            for version in 0..versions.count(cluster) {
                let group = versions.group(cluster, version) as u32;
                assert_eq!(versions.of(group), (cluster as u32, version as u32));
            }
        }
        assert_eq!(Versions::new(&[]).unwrap().groups(), 0);
    }

    #[test]
    fn what_is_not_there_is_named() {
        let refused = |error: CounterfactualError| error.to_string();
        assert!(refused(Versions::new(&[1, 0]).unwrap_err()).contains("cluster 1 has no version"));
        let versions = Versions::new(&[2, 1]).unwrap();
        let short = refused(versions.check(&[vec![0, 0], vec![1]]).unwrap_err());
        assert!(short.contains("1 clusters") && short.contains("need 2"), "{short}");
        let past = refused(versions.check(&[vec![2, 0]]).unwrap_err());
        assert!(past.contains("version 2 of cluster 0") && past.contains("below 2"), "{past}");
        versions.check(&[vec![1, 0]]).unwrap();
    }
}
