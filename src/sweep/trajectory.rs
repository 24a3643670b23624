//! Writes what simulations showed frame by frame as Parquet: a row per frame, a column per quantity.

use std::sync::Arc;

use emulator_host::{report::FrameRow, sweep::Trial};
use parquet::{
    data_type::{DoubleType, Int32Type, Int64Type},
    errors::Result,
    file::{properties::WriterProperties, writer::SerializedFileWriter},
    schema::parser::parse_message_type,
};

/// Time in nanoseconds since the session began; utility, miss and base miss as in a report.
const SCHEMA: &str = "message trajectory {
    required int64 simulation;
    required int32 frame;
    required int64 time_ns;
    required int64 usable_bytes;
    required double utility;
    required double miss;
    required double base_miss;
}";

/// The bytes of a Parquet file with the frames of `trials`; the same trials, the same bytes.
///
/// # Errors
/// What the writer refuses.
pub(super) fn parquet(trials: &[(Trial, Vec<FrameRow>)]) -> Result<Vec<u8>> {
    let frames = || trials.iter().flat_map(|(trial, frames)| frames.iter().map(move |frame| (trial, frame)));
    let whole = |of: &dyn Fn(&Trial, &FrameRow) -> u64| -> Vec<i64> {
        frames().map(|(trial, frame)| of(trial, frame).cast_signed()).collect()
    };
    let real = |of: &dyn Fn(&FrameRow) -> f64| -> Vec<f64> { frames().map(|(_, frame)| of(frame)).collect() };
    let schema = Arc::new(parse_message_type(SCHEMA)?);
    let properties = WriterProperties::builder().set_created_by("dgs".to_owned()).build();
    let mut bytes = Vec::new();
    let mut file = SerializedFileWriter::new(&mut bytes, schema, Arc::new(properties))?;
    let mut group = file.next_row_group()?;
    let longs: [Option<Vec<i64>>; 4] = [
        Some(whole(&|trial, _| trial.simulation)),
        None,
        Some(whole(&|_, frame| frame.time_ns.0)),
        Some(whole(&|_, frame| frame.usable_bytes)),
    ];
    for values in longs {
        let Some(mut column) = group.next_column()? else { break };
        match values {
            Some(values) => column.typed::<Int64Type>().write_batch(&values, None, None)?,
            None => {
                let numbers: Vec<i32> = frames().map(|(_, frame)| frame.frame.cast_signed()).collect();
                column.typed::<Int32Type>().write_batch(&numbers, None, None)?
            }
        };
        column.close()?;
    }
    for values in [real(&|frame| frame.utility), real(&|frame| frame.miss), real(&|frame| frame.base_miss)] {
        let Some(mut column) = group.next_column()? else { break };
        column.typed::<DoubleType>().write_batch(&values, None, None)?;
        column.close()?;
    }
    group.close()?;
    file.close()?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;
    use emulator_host::{
        Nanos, PolicyKind, Rate, Trace,
        graph::{Dependencies, Synthetic},
        link::LossModel,
        sweep::{Condition, Design, Sweep, SweptTrace},
    };
    use parquet::{
        file::reader::{FileReader, SerializedFileReader},
        record::RowAccessor,
    };

    use super::*;

    #[test]
    fn a_reader_finds_every_frame_as_it_was() {
        let design = Design {
            controllers: vec![emulator_host::ControllerKind::NewReno],
            schedulers: vec![PolicyKind::Layered, PolicyKind::Dash],
            conditions: vec![Condition {
                name: "clean".into(),
                dependencies: Dependencies::Layered,
                repair: None,
                loss: LossModel::None,
            }],
            traces: vec![SweptTrace {
                name: "bursty".into(),
                family: "made".into(),
                replay: Trace::bursty(1, Nanos::from_s(20)).into(),
                delay: Nanos::from_ms(20),
                light: None,
            }],
            replicates: 1,
            seed: 1,
            clip: Synthetic { frames: 30, ..Synthetic::default() },
            load: None,
            queue: Nanos::from_ms(250),
            uplink: Rate::from_mbps(2),
        };
        let trials = Sweep::new(design).unwrap().run_block(0).unwrap();
        let bytes = parquet(&trials).unwrap();
        assert_eq!(bytes, parquet(&trials).unwrap());
        let reader = SerializedFileReader::new(Bytes::from(bytes)).unwrap();
        let mut expected =
            trials.iter().flat_map(|(t, frames)| frames.iter().map(move |f| (t.simulation, f)));
        for row in reader.get_row_iter(None).unwrap() {
            let (row, (simulation, frame)) = (row.unwrap(), expected.next().unwrap());
            assert_eq!(row.get_long(0).unwrap(), simulation.cast_signed());
            assert_eq!(row.get_int(1).unwrap(), frame.frame.cast_signed());
            assert_eq!(row.get_long(2).unwrap(), frame.time_ns.0.cast_signed());
            assert_eq!(row.get_long(3).unwrap(), frame.usable_bytes.cast_signed());
            let reals = [4, 5, 6].map(|column| row.get_double(column).unwrap().to_bits());
            assert_eq!(reals, [frame.utility, frame.miss, frame.base_miss].map(f64::to_bits));
        }
        assert!(expected.next().is_none());
    }
}
