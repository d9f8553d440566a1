//! Where, when and in which regime the model fails, against the noise measured in the record itself.
