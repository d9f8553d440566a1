//! Which physical effect is missing from the model: instruments first, then parameters, then effects.
