        // A cell begins: what still passes each pixel weighs all that is in it.
//!repeat PART PARTS
        open_PART = select(ZERO, through_PART, through_PART >= vec4f(FINISHED));
        still = max(still, open_PART);
        most_PART = ZERO;
//!end
