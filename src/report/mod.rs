//! SVG figures and the self-contained HTML pages made of them.
