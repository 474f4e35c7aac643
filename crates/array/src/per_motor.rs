//! One value for each motor of an array.

use crate::spec::{Array, MAX_MOTORS};
use serde::{Serialize, Serializer};
use std::fmt;
use std::ops::{Deref, DerefMut};

/// As many values as the array has motors, in place: it is copied like a list of fixed length. It reads as a slice.
#[derive(Clone, Copy)]
pub struct PerMotor<T> {
    values: [T; MAX_MOTORS],
    motors: u8,
}

impl<T: Copy> PerMotor<T> {
    /// The same value for each motor.
    pub fn all(array: Array, value: T) -> Self {
        Self { values: [value; MAX_MOTORS], motors: array.motors() as u8 }
    }

    /// A value for each motor, by its number.
    pub fn from_fn(array: Array, mut of: impl FnMut(u8) -> T) -> Self {
        let mut all = Self::all(array, of(0));
        for (motor, value) in (0..).zip(all.iter_mut()).skip(1) {
            *value = of(motor);
        }
        all
    }

    /// What a function makes of each value.
    pub fn map<U: Copy>(&self, mut of: impl FnMut(T) -> U) -> PerMotor<U> {
        let mut values = [of(self.values[0]); MAX_MOTORS];
        for (value, from) in values.iter_mut().zip(&**self).skip(1) {
            *value = of(*from);
        }
        PerMotor { values, motors: self.motors }
    }
}

impl<T> Deref for PerMotor<T> {
    type Target = [T];
    #[inline]
    fn deref(&self) -> &[T] {
        &self.values[..usize::from(self.motors)]
    }
}

impl<T> DerefMut for PerMotor<T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.values[..usize::from(self.motors)]
    }
}

impl<T> IntoIterator for PerMotor<T> {
    type Item = T;
    type IntoIter = std::iter::Take<std::array::IntoIter<T, MAX_MOTORS>>;
    fn into_iter(self) -> Self::IntoIter {
        self.values.into_iter().take(usize::from(self.motors))
    }
}

impl<'a, T> IntoIterator for &'a PerMotor<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;
    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<'a, T> IntoIterator for &'a mut PerMotor<T> {
    type Item = &'a mut T;
    type IntoIter = std::slice::IterMut<'a, T>;
    fn into_iter(self) -> Self::IntoIter {
        self.iter_mut()
    }
}

impl<T: PartialEq> PartialEq for PerMotor<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl<T: Eq> Eq for PerMotor<T> {}

impl<T: fmt::Debug> fmt::Debug for PerMotor<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        (**self).fmt(f)
    }
}

impl<T: Serialize> Serialize for PerMotor<T> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        (**self).serialize(to)
    }
}
