use super::*;

/// The comparator must fail on each kind of wrong outcome.
#[test]
fn a_wrong_outcome_is_complained_about() {
    let case = cases(100).into_iter().find(|c| c.name == "60 twice").unwrap();
    let (good, truth) = (case.outcome().unwrap(), case.truth().unwrap());
    let verdict = case.check(&good, &truth);
    assert_eq!(verdict.complaints, [""; 0]);
    assert!(verdict.difference.max_clear > 0.0 && verdict.fast_error > 0.0, "{verdict:?}");

    let wrong = |change: &dyn Fn(&mut StressOutcome), expected: &str| {
        let mut outcome = good.clone();
        change(&mut outcome);
        let complaints = case.check(&outcome, &truth).complaints;
        assert!(complaints.iter().any(|c| c.contains(expected)), "{expected}: {complaints:?}");
    };
    let middle = 3 * (16 * 48 + 24);
    wrong(&|o| o.rendered.image.rgb_mut()[middle] += 0.01, "against f64");
    wrong(&|o| o.rendered.image.rgb_mut()[middle] = f32::NAN, "pixel is not finite");
    wrong(&|o| o.rendered.transmittance[3] = 1.5, "transmittance");
    wrong(&|o| o.rendered.counters.drawn -= 1, "counted once");
    wrong(&|o| o.gradients.splats[2].rotation[1] = f32::INFINITY, "gradient is not finite");
    wrong(&|o| o.gradients.pose.rotation[1] = f64::NAN, "gradient is not finite");
    wrong(&|o| o.gradients.rendered.image.rgb_mut()[0] = 7.0, "with gradients is another");
    wrong(&|o| o.worlds.strict[1] *= 1.0 + 1e-12, "strict differs");
    wrong(&|o| o.worlds.fast[1] *= 1.001, "fast sums");
    wrong(&|o| o.worlds.fast[1] = f64::NAN, "fast sums");
    wrong(&|o| o.worlds.utilities.delta[0] = f64::NAN, "sum of squares");
    wrong(&|o| o.rendered.image = Image::filled(2, 2, [0.0; 3]).unwrap(), "another size");
    let strict = StressCase { skipped: Some(3), ..case.clone() };
    assert!(!strict.check(&good, &truth).complaints.is_empty());
}

/// A case with a mistake in its camera would silently be a picture of one pixel.
#[test]
fn cases_are_what_they_say() {
    let all = cases(1000);
    let names = all.iter().map(|c| (c.family, c.name.as_str())).collect::<std::collections::BTreeSet<_>>();
    assert_eq!(names.len(), all.len(), "two cases of one name");
    assert!(all.iter().all(|c| c.splats().is_ok()));
    let single = all.iter().filter(|c| c.camera.width() == 1 && c.camera.height() == 1);
    assert!(single.map(|c| c.name.as_str()).eq(["1 x 1"; 2]));
}

#[test]
fn every_case_holds() {
    let mut complaints = Vec::new();
    for case in cases(5000) {
        let verdict = case.check(&case.outcome().unwrap(), &case.truth().unwrap());
        complaints.extend(verdict.complaints.into_iter().map(|c| format!("{}, {c}", case.family)));
    }
    assert!(complaints.is_empty(), "{complaints:#?}");
}

#[test]
fn what_is_refused_is_refused_by_name() {
    for refusal in refusals() {
        assert!(refusal.holds(), "{refusal:?}");
    }
    let taken = Refusal { api: "a", what: "b", error: None, words: &[] };
    let vague = Refusal { error: Some("bad input".into()), words: &["width"], ..taken.clone() };
    assert!(!taken.holds() && !vague.holds());
}
