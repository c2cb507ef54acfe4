        // A cell ends: in which pixels did it take what was left of half of the light?
        if (PICK) {
//!repeat PART PARTS
            {
                let halved = (open_PART >= vec4f(0.5)) & (through_PART < vec4f(0.5));
                green_PART = select(green_PART, most_depth_PART, halved);
                taker_PART = select(taker_PART, most_id_PART, halved);
            }
//!end
        }
