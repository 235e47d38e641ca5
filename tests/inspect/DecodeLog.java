import java.io.ByteArrayOutputStream;
import java.io.DataInputStream;
import java.io.DataOutputStream;
import java.io.ByteArrayInputStream;
import java.io.EOFException;
import java.util.Arrays;
import lcm.lcm.LCMEncodable;
import lcm.logging.Log;
import lcm.spy.LCMTypeDatabase;

/** Decodes every event of a log as lcm-spy does, encodes it again, and prints channel, type and whether it is the same. */
public class DecodeLog {
    public static void main(String[] arguments) throws Exception {
        LCMTypeDatabase database = new LCMTypeDatabase();
        Log log = new Log(arguments[0], "r");
        while (true) {
            Log.Event event;
            try {
                event = log.readNext();
            } catch (EOFException end) {
                return;
            }
            long fingerprint = new DataInputStream(new ByteArrayInputStream(event.data)).readLong();
            Class<?> type = database.getClassByFingerprint(fingerprint);
            if (type == null) {
                System.out.println("RESULT " + event.channel + " unknown false");
                continue;
            }
            Object message = type.getConstructor(java.io.DataInput.class)
                .newInstance(new DataInputStream(new ByteArrayInputStream(event.data)));
            ByteArrayOutputStream bytes = new ByteArrayOutputStream();
            ((LCMEncodable) message).encode(new DataOutputStream(bytes));
            boolean same = Arrays.equals(bytes.toByteArray(), event.data);
            System.out.println("RESULT " + event.channel + " " + type.getName() + " " + same);
        }
    }
}
