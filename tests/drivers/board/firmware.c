/* The link to the valve board as firmware would have it: docs/board-protocol.md and `make headers`, no library.
 *
 * Reads frames from the standard input, decodes each message into its struct, encodes that anew and writes the frame.
 * Tells of each command what the channels are to do. Ends with 1 at the first damaged frame, saying why.
 */
#include <inttypes.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "imolo_msgs_actuator_command_t.h"
#include "imolo_msgs_board_arm_t.h"
#include "imolo_msgs_board_challenge_t.h"
#include "imolo_msgs_board_clock_t.h"
#include "imolo_msgs_board_hello_t.h"
#include "imolo_msgs_board_proof_t.h"
#include "imolo_msgs_board_refusal_t.h"
#include "imolo_msgs_board_state_t.h"
#include "imolo_msgs_board_trial_t.h"
#include "imolo_msgs_board_welcome_t.h"

#define HEADER 24
#define SIGNED 20 /* bytes of the header that the CRC is taken over */
#define LONGEST 16384

static uint32_t crc32(uint32_t crc, const uint8_t *data, size_t length)
{
    crc = ~crc;
    while (length--) {
        crc ^= *data++;
        for (int bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return ~crc;
}

static uint32_t big_endian(const uint8_t *bytes, int count)
{
    uint32_t value = 0;
    for (int i = 0; i < count; i++)
        value = value << 8 | bytes[i];
    return value;
}

static int fail(const char *why)
{
    fprintf(stderr, "%s\n", why);
    return 1;
}

static void tell(const imolo_msgs_actuator_command_t *command)
{
    fprintf(stderr, "%" PRId32 " %" PRId64 " %" PRId32, command->command_sequence, command->onset_utime, command->num_phases);
    for (int phase = 0; phase < command->num_phases; phase++) {
        fprintf(stderr, " %" PRId64, command->switch_utime[phase]);
        for (int channel = 0; channel < command->num_targets; channel++)
            fprintf(stderr, " %.17g", command->target[phase][channel]);
    }
    fprintf(stderr, "\n");
}

#define NOTHING(message) ((void)(message))

/* Decode a message into its struct, use it, and encode it again; it must be exactly as long as its content. */
#define REPEAT(name, use)                                                          \
    do {                                                                           \
        imolo_msgs_##name message;                                                 \
        if (imolo_msgs_##name##_decode(payload, 0, length, &message) != length)    \
            return fail("no " #name);                                              \
        use(&message);                                                             \
        length = imolo_msgs_##name##_encode(payload, 0, LONGEST, &message);        \
        imolo_msgs_##name##_decode_cleanup(&message);                              \
    } while (0)

int main(void)
{
    static uint8_t frame[HEADER + LONGEST];
    uint8_t *payload = frame + HEADER;

    while (fread(frame, 1, HEADER, stdin) == HEADER) {
        int length = (int)big_endian(frame + 6, 2);
        if (memcmp(frame, "IMB1", 4) != 0)
            return fail("magic");
        if (length > LONGEST || fread(payload, 1, (size_t)length, stdin) != (size_t)length)
            return fail("length");
        if (crc32(crc32(0, frame, SIGNED), payload, (size_t)length) != big_endian(frame + SIGNED, 4))
            return fail("crc");

        switch (big_endian(frame + 4, 2)) {
        case 1: REPEAT(board_hello_t, NOTHING); break;
        case 2: REPEAT(board_welcome_t, NOTHING); break;
        case 3: REPEAT(board_refusal_t, NOTHING); break;
        case 4: REPEAT(board_arm_t, NOTHING); break;
        case 5: REPEAT(actuator_command_t, tell); break;
        case 6: REPEAT(board_state_t, NOTHING); break;
        case 7: REPEAT(board_clock_t, NOTHING); break;
        case 8: REPEAT(board_trial_t, NOTHING); break;
        case 9: REPEAT(board_challenge_t, NOTHING); break;
        case 10: REPEAT(board_proof_t, NOTHING); break;
        default: return fail("type");
        }

        frame[6] = (uint8_t)(length >> 8);
        frame[7] = (uint8_t)length;
        uint32_t crc = crc32(crc32(0, frame, SIGNED), payload, (size_t)length);
        for (int i = 0; i < 4; i++)
            frame[SIGNED + i] = (uint8_t)(crc >> (24 - 8 * i));
        fwrite(frame, 1, (size_t)(HEADER + length), stdout);
    }
    return 0;
}
