//! Mean, standard deviation and root mean square.

/// The mean of at least one value.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The standard deviation of these values themselves: the squares are divided by their number.
pub fn sd(values: &[f64]) -> f64 {
    let mean = mean(values);
    rms(values.iter().map(|value| value - mean))
}

/// The standard error of the mean.
pub fn standard_error(values: &[f64]) -> f64 {
    sd(values) / (values.len() as f64).sqrt()
}

/// The root mean square.
pub fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (count, squares) =
        values.into_iter().fold((0.0, 0.0), |(count, squares), value| (count + 1.0, squares + value * value));
    (squares / count).sqrt()
}
