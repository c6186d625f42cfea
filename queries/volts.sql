-- Raw codes to volts: every sample of one capture's exposures, as recorded, at its time after the trigger.
-- Needs the table `traces` with its codes (`codes = "zstd"` under [traces]); of an index volts.py reads the raw files. For integer codes (code_type i8, u8, i16...), which all scopes write; for floats see volts.py.
SET VARIABLE results = 'results';
SET VARIABLE lit = 1;
SET VARIABLE seen = 2;

WITH records AS (
    SELECT *,
        hex(coalesce(codes, error('the samples lie in ' || codes_file || '; `codes = "zstd"` under [traces] archives them'))) AS digits,
        CAST(code_type[2:] AS INTEGER) // 8 AS width
    FROM read_parquet(getvariable('results') || '/traces/*.parquet')
    WHERE role = 'scene' AND lit = getvariable('lit') AND seen = getvariable('seen') AND code_type[1] IN ('i', 'u')
), samples AS (
    -- Little-endian: the first byte counts least.
    SELECT * EXCLUDE (i), CAST(i AS INTEGER) AS sample,
        list_sum([CAST('0x' || digits[2 * (i * width + k) + 1 : 2 * (i * width + k) + 2] AS BIGINT) << (8 * k) FOR k IN range(width)]) AS bits
    FROM (SELECT *, unnest(range(samples)) AS i FROM records)
)
SELECT campaign, sensor, lit, seen, shot, is_reference, sample,
    t0_ps + sample * dt_ps AS time_ps,
    gain_v * (bits - CASE WHEN code_type[1] = 'i' AND bits >= 1 << (8 * width - 1) THEN 1 << (8 * width) ELSE 0 END) + offset_v AS volts
FROM samples
ORDER BY campaign, sensor, shot, is_reference, sample;
