//! Reading and writing CSV.

use super::*;
use proptest::prelude::*;

fn parse(text: &str, maps: &[&str]) -> Result<Record, CsvError> {
    let mappings: Vec<Mapping> = maps.iter().map(|m| m.parse().unwrap()).collect();
    parse_csv(text.as_bytes(), Path::new("flight.csv"), &mappings)
}

#[test]
fn units_become_si_and_gaps_become_nan() {
    let text = "# a comment\nt[ms],roll[deg],u_roll, v [m/s]\n0,180, 0.5,1\n10,,NaN,-2e0\n";
    let record = parse(text, &[]).unwrap();
    assert_eq!(record.time, [0.0, 0.01]);
    let roll = record.signal("roll").unwrap();
    assert_eq!((roll.unit.as_str(), roll.values[0]), ("rad", std::f64::consts::PI));
    assert!(roll.values[1].is_nan() && record.signal("u_roll").unwrap().values[1].is_nan());
    assert_eq!(record.signal("v").unwrap().values, [1.0, -2.0]);
}

#[test]
fn time_may_be_samples_or_another_column() {
    let record = parse("t[samples],y[V]\n0,1\n1,2\n", &[]).unwrap();
    assert_eq!(record.time_unit, "samples");
    let record = record.with_sample_period(0.5);
    assert_eq!((record.time_unit.as_str(), record.time[1]), ("s", 0.5));
    // A table without any column for the time.
    let record = parse("y,u\n5,1\n6,2\n", &["t=#[samples]"]).unwrap().with_sample_period(0.5);
    assert_eq!(
        (record.time.as_slice(), record.names()),
        (&[0.0, 0.5][..], vec!["y".to_string(), "u".into()])
    );
    let record = parse("y,stamp\n1,0\n2,1000\n", &["t=stamp[us]", "roll=-y[deg]"]).unwrap();
    assert_eq!(record.time, [0.0, 1e-3]);
    assert_eq!(record.names(), ["roll"]);
    // A head as spreadsheets and plotting programs write it; without a unit it is ambiguous.
    assert_eq!(parse("Time [ms],y\n0,1\n1,2\n", &[]).unwrap().time, [0.0, 1e-3]);
    let record =
        parse("Time (ms),Motor Speed (deg/s),acc (IMU)\n0,180,1\n1,0,2\n", &["w=Motor Speed (deg/s)"]);
    let record = record.unwrap();
    assert_eq!((record.time[1], record.get("w").unwrap().values[0]), (1e-3, std::f64::consts::PI));
    assert!(record.get("acc (IMU)").is_some());
    assert!(parse("time,y\n0,1\n1,2\n", &[]).is_err());
    // Or as programs that write tables do.
    for (head, period) in [("t_s", 1.0), ("time_ms", 1e-3), ("timestamp_us", 1e-6), ("Timestamp[us]", 1e-6)] {
        assert_eq!(parse(&format!("{head},y\n0,1\n1,2\n"), &[]).unwrap().time, [0.0, period], "{head}");
    }
    for head in ["time_h", "t_start", "timestamp", "s"] {
        assert!(parse(&format!("{head},y\n0,1\n1,2\n"), &[]).is_err(), "{head}");
    }
}

#[test]
fn other_separators_and_byte_order_marks_are_read() {
    assert_eq!(parse("\u{feff}t;y\n0;1\n", &[]).unwrap().names(), ["y"]);
    assert_eq!(parse("t\ty\n0\t1\n", &[]).unwrap().names(), ["y"]);
    let record = parse(" t_s   y  z\n  0.0   1.5  -2\n  1e-1 2.5   3 \n", &[]).unwrap();
    assert_eq!((record.names().len(), record.time[1], record.get("z").unwrap().values[1]), (2, 0.1, 3.0));
    // As spreadsheets write numbers where the comma is the decimal point.
    let record = parse("t;y;z\n-0,4;1,5;2.5\n0;-1e-1;\n", &[]).unwrap();
    assert_eq!((record.time[0], record.get("y").unwrap().values[0]), (-0.4, 1.5));
    assert_eq!(record.get("z").unwrap().values[0], 2.5);
    assert!(parse("t;y\n0;1,000,5\n", &["u=y"]).unwrap_err().to_string().contains("'1,000,5'"));
}

/// As logs are written whose clock is set only after their first rows, or whose last line is a comment.
#[test]
fn rows_without_a_time_and_comments_at_the_end_are_left_out() {
    let record = parse("t,y\n,1\n0,2\n1,3\n\n# a\n# b, c", &[]).unwrap();
    assert_eq!((record.time.len(), record.get("y").unwrap().values[0]), (2, 2.0));
    assert_eq!(record.left_out_rows().remarks(), ["rows left out because they have no time: 1"]);
}

/// As the tables that are made of the logs of flight controllers.
#[test]
fn the_only_column_that_is_a_time_by_its_name_may_stand_anywhere() {
    let record = parse("loopIteration, time (us), gyro[0]\n0, 1000000, 1\n1, 1000500, 2\n", &[]).unwrap();
    assert_eq!(record.time, [1.0, 1.0005]);
    assert!(parse("n,time (us),time_ms\n0,1,2\n", &[]).is_err());
}

/// A mode in words, an unknown unit and a duplicate name do not affect a user who asks for other columns.
#[test]
fn a_column_that_cannot_be_read_is_an_error_where_it_is_asked_for() {
    let cases = [
        (
            "t,roll,y\n0,1,2\n1,2,x\n",
            "flight.csv, line 3, column 3 (y): 'x' is not a finite number; leave the cell empty for a gap",
        ),
        (
            "t,roll,y\n0,1,inf\n1,2,3\n",
            "flight.csv, line 2, column 3 (y): 'inf' is not a finite number; leave the cell empty for a gap",
        ),
        ("t,y,roll,y[deg]\n0,3,1,3\n1,3,2,3\n", "flight.csv, line 1: two columns are called 'y'"),
        (
            "t,roll,y\n0,1,2\n1,2,-1e308\n",
            "flight.csv, line 3, column 3 (y): -1e308 exceeds 1e30, which is not a plausible measurement",
        ),
        ("t,y,roll\n0,,1\n1,NaN,2\n", "flight.csv, column 2 (y): the column has no values"),
        ("t,roll,y[furlong]\n0,1,3\n1,2,3\n", "signal 'y' of flight.csv: 'furlong'"),
    ];
    for (text, expected) in cases {
        let record = parse(text, &[]).unwrap();
        assert_eq!((record.names(), record.signal("roll").unwrap().values[1]), (vec!["roll".into()], 2.0));
        let error = record.signal("y").unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
        assert_eq!(record.find("y").unwrap_err().to_string(), error);
        assert_eq!(record.between(0.0, 0.5).signal("y").unwrap_err().to_string(), error);
        assert_eq!(record.unreadable()[0].name, "y");
        let error = parse(text, &["pitch=y"]).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
    }
}

/// Loggers stamp a row twice with the same time now and then, and some write the signals of one time in several rows.
#[test]
fn rows_at_the_same_time_are_one() {
    let record = parse("t,y,note\n0,1,x\n1,2,x\n1,3,x\n2,4,x\n2,4,x\n", &[]).unwrap();
    assert_eq!(record.time, [0.0, 1.0, 2.0]);
    assert_eq!(record.get("y").unwrap().values, [1.0, 3.0, 4.0], "the later value holds");
    let told = record.between(0.5, 2.0).left_out_rows().remarks();
    assert_eq!(told, ["rows left out because the row after has other values at the same time: 1"]);
    let record = parse("t,y,z\n0,1,\n0,,5\n1,2,\n1,,6\n1,,\n", &[]).unwrap();
    assert_eq!(record.time, [0.0, 1.0]);
    let values = ["y", "z"].map(|name| record.get(name).unwrap().values.clone());
    assert_eq!(values, [[1.0, 2.0], [5.0, 6.0]], "nothing is lost");
    assert!(record.left_out_rows().remarks().is_empty());
}

#[test]
fn errors_name_file_line_and_column() {
    let cases = [
        (
            "",
            "flight.csv, line 1: the first column is '', expected t, t[unit], time[unit] or time_s; --map t=COLUMN[unit] names another (`vehicle new`: --time COLUMN[unit]) of none; t=#[samples] counts the rows, and --period tells the time between them",
        ),
        (
            "time,y\n0,1\n",
            "flight.csv, line 1: the first column is 'time', expected t, t[unit], time[unit] or time_s; --map t=COLUMN[unit] names another (`vehicle new`: --time COLUMN[unit]) of 'time', 'y'; t=#[samples] counts the rows, and --period tells the time between them",
        ),
        (
            "0.0,1,-2e3\n0.1,2,3\n",
            "flight.csv, line 1: '0.0' is a number where the name of a column is expected: the table has no header. Add a first line with a name for each column, such as `t,u_roll,roll_rate[deg/s]`, with commas, semicolons, tabs or blanks between them; `t[samples]` where rows are only counted",
        ),
        ("t[m],y\n", "flight.csv, line 1: the time column is in 'm', expected s, ms, us, min or samples"),
        (
            "t,y\n1,1\n0,2\n",
            "flight.csv, line 3: time 0 comes after 1; it must not go back from line to line",
        ),
        (
            "t,y\n0,1\n0,2\n0,3\n",
            "flight.csv: 2 of 3 rows have other values at the time of the row before; the time column is too coarse, use another one or, for rows at a constant rate, one that counts them (--map t=COLUMN[samples])",
        ),
        (
            "t,y\n,1\n",
            "flight.csv: 1 of 1 rows have no time in column 't'; choose another column (--map t=COLUMN[unit])",
        ),
        ("t,y\n0,1,2\n", "flight.csv, line 2: 3 cells, but the header has 2 columns"),
    ];
    for (text, expected) in cases {
        assert_eq!(parse(text, &[]).unwrap_err().to_string(), expected);
    }
    let unit = parse("t,y[furlong]\n0,1\n", &["roll=y"]).unwrap_err().to_string();
    assert!(unit.starts_with("signal 'y' of flight.csv: 'furlong'"), "{unit}");
    assert!(
        read_csv("/does/not/exist.csv", &[]).unwrap_err().to_string().starts_with("/does/not/exist.csv: ")
    );
}

#[test]
fn what_is_no_table_of_numbers_is_refused_at_once_and_with_its_place() {
    let many: String = (0..100_000).map(|i| format!(",c{i}")).collect();
    let huge = "9".repeat(50_000_000);
    let cases = [
        (format!("t{many}\n"), "flight.csv, line 1: 100001 columns, but at most 10000 are supported"),
        (format!("t,y\n0,1\n1,{huge}\n"), "flight.csv, line 3: the line has more than 4194304 bytes"),
        (
            format!("t,y\n0,1\n1,\"{}", "1,2\n".repeat(5_000_000)),
            "flight.csv, line 3: the line has more than 4194304 bytes",
        ),
        (format!("t,{huge}\n"), "flight.csv, line 1: the line has more than 4194304 bytes"),
    ];
    for (text, expected) in cases {
        let began = std::time::Instant::now();
        let error = parse(&text, &[]).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
        assert!(began.elapsed().as_secs_f64() < 1.0, "{expected}: {:?}", began.elapsed());
    }
    let long = parse(&format!("t,y\n0,{}x\n", "9".repeat(100_000)), &["roll=y"]).unwrap_err().to_string();
    assert!(long.len() < 250, "{long}");
}

prop_compose! {
    fn any_record()(rows in 0usize..40, columns in 0usize..5)(
        steps in prop::collection::vec(1e-6f64..10.0, rows),
        start in -1e6f64..1e6,
        values in prop::collection::vec(
            prop::collection::vec(prop_oneof![-GREATEST..GREATEST, -1e-9..1e-9, Just(0.0), Just(f64::NAN)], rows),
            columns,
        ),
    ) -> Record {
        let time = steps.iter().scan(start, |t, dt| { *t += dt; Some(*t) }).collect();
        let mut record = Record::new("round.csv", time).unwrap();
        for (i, mut v) in values.into_iter().enumerate() {
            // A column without a value is unreadable, so one value is set.
            v.iter_mut().take(1).filter(|v| v.is_nan()).for_each(|v| *v = -0.0);
            record.push(format!("s,{i} \"q\""), ["rad/s", "", "m/s^2"][i % 3], v).unwrap();
        }
        record
    }
}

proptest! {
    #[test]
    fn a_written_record_reads_back_bit_for_bit(record in any_record()) {
        let mut text = Vec::new();
        format_csv(&record, &mut text).unwrap();
        let back = parse_csv(&text[..], Path::new("round.csv"), &[]).unwrap();
        let bits = |v: &[f64]| v.iter().map(|x| if x.is_nan() { 0 } else { x.to_bits() }).collect::<Vec<_>>();
        prop_assert_eq!(bits(&back.time), bits(&record.time));
        prop_assert_eq!(back.names(), record.names());
        for (a, b) in back.signals().iter().zip(record.signals()) {
            prop_assert_eq!(&a.unit, &b.unit);
            prop_assert_eq!(bits(&a.values), bits(&b.values));
        }
    }

    #[test]
    fn any_text_is_a_record_or_an_error(text in "[t,y;\\[\\]\n\r\"0-9.e#\u{0}é-]{0,80}") {
        let _ = parse(&text, &[]);
    }
}
